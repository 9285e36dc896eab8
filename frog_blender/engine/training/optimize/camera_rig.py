"""The cameras of a training as they are known now: poses and exposures are learned with the scene."""

from __future__ import annotations

from dataclasses import dataclass

from ...capture.capture import Capture


@dataclass
class CameraRig:
    """What refines cameras shares.

    Attributes:
        capture: with its cameras as they are known now.
    """

    capture: Capture
