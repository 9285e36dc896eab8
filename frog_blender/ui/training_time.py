"""The estimated duration of a training, as text."""

from __future__ import annotations

from typing import Any

from ..engine.capture.capture import Capture


def expected(settings: Any, capture: Capture) -> str:
    """The estimate for ``Scene.frog`` and its capture. Neither decodes nor imports torch."""
    from ..engine.training.recipe import recipe
    from ..engine.training.session.job import usual_scale
    from ..engine.training.session.time_estimate import Workload, estimate, likely_device

    scale = settings.image_scale or usual_scale(capture.cameras)
    work = Workload.of(capture, recipe(settings.recipe), settings.steps or None, scale)
    return f"{estimate(work, likely_device(settings.device), limit=60.0 * settings.minutes or None)}."
