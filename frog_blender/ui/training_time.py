"""The estimated duration of a training, as text."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from .. import addon_state
from ..engine.capture.capture import Capture
from ..engine.errors import FrogError
from ..tasks import training


class DecodedFrames:
    """Whether the frames of the capture that was asked for last are on disk.

    Attributes:
        key: the capture, the scale, and the training since which it may be otherwise.
        found: the answer.
    """

    def __init__(self) -> None:
        self.key: tuple[object, ...] = ()
        self.found = False


def expected(settings: Any, capture: Capture) -> str:
    """The estimate for ``Scene.frog`` and its capture. Neither decodes nor imports torch."""
    from ..engine.training.recipe import recipe
    from ..engine.training.session.job import usual_scale
    from ..engine.training.session.time_estimate import Workload, estimate, likely_device

    scale = settings.image_scale or usual_scale(capture.cameras)
    work = Workload.of(capture, recipe(settings.recipe), settings.steps or None, scale)
    device, limit = likely_device(settings.device), 60.0 * settings.minutes or None
    return f"{estimate(work, device, prepared=_is_decoded(capture, scale), limit=limit)}."


def _is_decoded(capture: Capture, scale: float) -> bool:
    """Whether an earlier training has left the frames on disk; looks again once a training has begun or ended."""
    from ..engine.frames.store import is_decoded

    known, task = addon_state.get(DecodedFrames), training.current()
    key = (capture, scale, task, task is not None and task.is_running)
    if known.key != key:
        known.key, known.found = key, False
        with suppress(FrogError):  # a scale that leaves no pixels, of which the training tells
            known.found = is_decoded(capture.scaled(scale))
    return known.found
