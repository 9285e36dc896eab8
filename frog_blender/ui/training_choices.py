"""Choices of a training that the panel shows in words, where the settings hold a number that stands for "the default".

They are kept in that number alone, which presets and scripts set.
"""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty

from ..engine.capture.capture import Capture
from . import capture_summary

LENGTHS = (
    ("RECIPE", "As the Quality", "As many steps as the quality needs for this capture", 0),
    ("STEPS", "Steps", "A number of steps", 1),
    ("TIME", "Time", "As many steps as fit into a time", 2),
)
HOLDOUTS = (
    ("CAPTURE", "As the Capture", "What the capture's format leaves out", 0),
    ("NONE", "Nothing", "Train on every frame", 1),
    ("FRAMES", "Every n-th Frame", "Leave frames out, and measure quality on them", 2),
)
_MINUTES, _EVERY = 10.0, 8  # where the user chooses a time, or frames


def known_capture(settings: Any) -> Capture | None:
    """The capture of ``Scene.frog``, if its folder was read."""
    summary = capture_summary.known(bpy.path.abspath(settings.capture_folder)) if settings.capture_folder else None
    return summary.capture if summary is not None else None


def usual_steps(settings: Any) -> int:
    """The steps of the chosen recipe, for the capture if it is known."""
    from ..engine.recipes import recipe

    chosen, capture = recipe(settings.recipe), known_capture(settings)
    return chosen.steps_for(capture.frame_count) if capture is not None else chosen.steps


def usual_image_scale(settings: Any) -> float:
    """The factor that images are resized by where none is chosen."""
    from ..engine.training.session.job import usual_scale

    capture = known_capture(settings)
    return usual_scale(capture.cameras) if capture is not None else 1.0


def usual_gaussians(settings: Any) -> int:
    """How many Gaussians a scene of the chosen recipe has at most."""
    from ..engine.recipes import recipe

    return recipe(settings.recipe).max_gaussians


def _length(settings: Any) -> int:
    return 2 if settings.minutes > 0 else 1 if settings.steps else 0


def _set_length(settings: Any, value: int) -> None:
    settings.minutes = (settings.minutes or _MINUTES) if value == 2 else 0.0
    settings.steps = (settings.steps or usual_steps(settings)) if value == 1 else 0


def _set_own_scale(settings: Any, value: bool) -> None:
    settings.image_scale = (settings.image_scale or usual_image_scale(settings)) if value else 0.0


def _holdout(settings: Any) -> int:
    return 2 if settings.holdout_frames > 0 else settings.holdout_frames + 1


def _set_holdout(settings: Any, value: int) -> None:
    settings.holdout_frames = max(settings.holdout_frames, 0) or _EVERY if value == 2 else value - 1


def _set_limited(settings: Any, value: bool) -> None:
    settings.max_gaussians = (settings.max_gaussians or usual_gaussians(settings)) if value else 0


class TrainingChoices:
    """A base of ``Scene.frog``, which has ``steps``, ``minutes``, ``image_scale``, ``holdout_frames`` and
    ``max_gaussians``.
    """

    length: EnumProperty(
        name="Length",
        description="When the training ends",
        items=[(name, label, description, "NONE", number) for name, label, description, number in LENGTHS],
        get=_length,
        set=_set_length,
        options={"SKIP_SAVE"},
    )
    has_image_scale: BoolProperty(
        name="Resize Images",
        description="Resize the training images by a factor. Otherwise only images larger than 1600 pixels are",
        get=lambda settings: settings.image_scale > 0,
        set=_set_own_scale,
        options={"SKIP_SAVE"},
    )
    holdout: EnumProperty(
        name="Leave Out",
        description="What is not trained on, so that quality can be measured on it",
        items=[(name, label, description, "NONE", number) for name, label, description, number in HOLDOUTS],
        get=_holdout,
        set=_set_holdout,
        options={"SKIP_SAVE"},
    )
    has_max_gaussians: BoolProperty(
        name="Limit Splats",
        description="Limit the number of splats of the scene",
        get=lambda settings: settings.max_gaussians > 0,
        set=_set_limited,
        options={"SKIP_SAVE"},
    )
