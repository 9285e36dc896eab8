"""What a calibration finds, and the refusal where the footage does not fix it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError
from ..camera import Camera
from .evidence import CameraEvidence, PairEvidence


class CalibrationRefused(FrogError):
    """The footage does not fix its cameras; the sentence says why, and what to film next time."""


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """One camera and what supports it.

    Attributes:
        camera: without its distortion; the principal point in the middle.
        distortion: k1 and k2 in OpenCV's order.
        evidence: see ``evidence``.
        observations: (N, 3) some of its observations: x and y in pixels, and 1 for those that agree with the rest.
    """

    camera: Camera
    distortion: tuple[float, float]
    evidence: CameraEvidence
    observations: Float64s


@dataclass(frozen=True, eq=False)
class Calibration:
    """The cameras of a rig. World: z up, y ahead, the origin where the cameras look; the scale is free.

    Attributes:
        cameras: in the order of the views.
        points: (N, 3) float64 points on surfaces.
        pairs: what connects the cameras, by their places.
        start: focal length over the width that the search started from.
        own_focals: cameras of equal size have focal lengths of their own.
        costs: of all starts that found a model.
        halves_apart: how far cameras lie apart when half of the points are used each, over the rig's diameter; NaN
            where nothing compared them.
        warnings: one sentence each.
        is_metric: the scale is not free: lengths are metres.
        source: what the cameras come from.
    """

    cameras: tuple[CalibratedCamera, ...]
    points: Float64s = field(default_factory=lambda: np.empty((0, 3)))
    pairs: tuple[PairEvidence, ...] = ()
    start: float = 0.0
    own_focals: bool = False
    costs: tuple[float, ...] = ()
    halves_apart: float = 0.0
    warnings: tuple[str, ...] = ()
    is_metric: bool = False
    source: str = "features"
