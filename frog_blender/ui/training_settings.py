"""Settings on scenes: what to train, and how.

Where a setting is a number of which one value stands for "the default", scripts set the number; the panel
shows the choice between the two in words, by a property that is kept in that number alone.
"""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy.props import PointerProperty

from .. import relative_paths
from ..engine.options import OPTIONS, panel_options
from ..engine.recipes import recipe
from ..engine.training.session.output_paths import free_output
from ..option_properties import items_of, property_name, property_of
from ..properties import HIDDEN, choice, folder, number, path, switch, text, vector
from ..tasks.training import TrainingTask
from ..tasks.training_request import KEY_MASKS
from ..viewport import drawing, views
from . import capture_reading, capture_summary
from .rig_settings import FrogRigSettings

_FOLDER, *_OTHERS = items_of(OPTIONS["masks"])
MASKS = (_FOLDER, (KEY_MASKS, "Key Colour", "The same, and a backdrop of one colour is not learned"), *_OTHERS)
LENGTHS = (
    ("RECIPE", "As the Quality", "As many steps as the quality needs for this capture"),
    ("STEPS", "Steps", "A number of steps"),
    ("TIME", "Time", "As many steps as fit into a time"),
)
HOLDOUTS = (
    ("CAPTURE", "As the Capture", "What the capture's format leaves out"),
    ("NONE", "Nothing", "Train on every frame"),
    ("FRAMES", "Every n-th Frame", "Leave frames out, and measure quality on them"),
)
_MINUTES, _EVERY = 10.0, 8  # where the user chooses a time, or frames


def usual_steps(settings: Any) -> int:
    """The steps of the chosen recipe, for the capture if it is known."""
    chosen, capture = recipe(settings.recipe), capture_summary.of(settings).capture
    return chosen.steps_for(capture.frame_count) if capture is not None else chosen.steps


def usual_image_scale(settings: Any) -> float:
    """The factor that images are resized by where none is chosen."""
    capture = capture_summary.of(settings).capture
    return capture.usual_scale if capture is not None else 1.0


def usual_gaussians(settings: Any) -> int:
    """How many Gaussians a scene of the chosen recipe has at most."""
    return recipe(settings.recipe).max_gaussians


def _set_length(settings: Any, value: int) -> None:
    settings.minutes = (settings.minutes or _MINUTES) if value == 2 else 0.0
    settings.steps = (settings.steps or usual_steps(settings)) if value == 1 else 0


def _set_holdout(settings: Any, value: int) -> None:
    settings.holdout_frames = max(settings.holdout_frames, 0) or _EVERY if value == 2 else value - 1


def _own(name: str, usual: Callable[[Any], float]) -> dict[str, Any]:
    """Of a check box that is kept in a number alone: it is off where that is 0, and begins with the usual one."""

    def put(settings: Any, value: bool) -> None:
        setattr(settings, name, (getattr(settings, name) or usual(settings)) if value else 0)

    return {"get": lambda settings: getattr(settings, name) > 0, "set": put, "options": {"SKIP_SAVE"}}


def _on_capture_folder(settings: Any, _context: bpy.types.Context) -> None:
    if not relative_paths.are_being_written():
        settings.property_unset("layout")
        views.count_as_untouched()
        capture_reading.read(bpy.path.abspath(settings.capture_folder))
        _derive_output(settings)


def choose_capture(settings: Any, folder: str, summary: capture_summary.CaptureSummary) -> None:
    """Makes a folder that was just read the capture of ``Scene.frog``, without reading it again."""
    with relative_paths.being_written():
        settings.capture_folder = folder
    settings.property_unset("layout")
    views.count_as_untouched()
    capture_reading.show(folder, summary, capture_summary.stamp(folder))
    _derive_output(settings)


def _derive_output(settings: Any) -> None:
    """Names the output after the capture, unless another name was chosen."""
    if settings.capture_folder and settings.output_path in ("", settings.derived_output):
        capture = Path(bpy.path.abspath(settings.capture_folder))
        settings.derived_output = settings.output_path = str(free_output(Path(f"{capture}.frog"), capture))


def camera_names(settings: Any, _context: bpy.types.Context, typed: str) -> list[str]:
    """Search suggestions for the preview camera."""
    return [name for name in capture_summary.of(settings).cameras if typed.lower() in name.lower()]


def _on_show_rig(_settings: Any, _context: bpy.types.Context) -> None:
    drawing.changed()


def _on_preview_camera(settings: Any, _context: bpy.types.Context) -> None:
    task = TrainingTask.current()
    if task is not None:
        task.control.preview_camera = settings.preview_camera


class TrainingSettings:
    """A base of ``Scene.frog``: what to train, and how."""

    rig: PointerProperty(type=FrogRigSettings)

    capture_folder: folder(
        "Capture", "Folder with the videos or images and their camera calibration", update=_on_capture_folder
    )
    output_path: path("Output", "The .frog scene file that training writes")
    derived_output: text(
        "Derived Output",
        "The output path derived from the capture's name. It follows the capture as long as the output is not changed "
        "by hand",
        options=HIDDEN,
    )
    key_color: vector(
        "Key Colour", "Colour of the backdrop", (0.0, 177 / 255, 64 / 255), subtype="COLOR_GAMMA", min=0.0, max=1.0
    )
    key_tolerance: number(
        "Tolerance",
        "How much less of the key colour than its own a pixel of the backdrop may have, in shadows for example",
        0.4,
        min=0.0,
        max=0.95,
    )
    show_rig: switch(
        "Draw Rig",
        "Draw the capture's cameras into the viewport until a scene of it is imported",
        True,
        update=_on_show_rig,
    )
    show_live: switch(
        "Show in Viewports",
        "Show the scene in the viewports while it is trained. It takes 2 % of the training's time",
        True,
        update=_on_show_rig,
    )
    import_when_done: switch(
        "Import When Done",
        "Import the trained scene into this one as soon as it is finished. Settings of a scene that you have changed "
        "are not touched",
        True,
    )
    length: choice(
        "Length",
        "When the training ends",
        LENGTHS,
        get=lambda settings: 2 if settings.minutes > 0 else 1 if settings.steps else 0,
        set=_set_length,
        options={"SKIP_SAVE"},
    )
    has_image_scale: switch(
        "Resize Images",
        "Resize the training images by a factor. Otherwise only images larger than 1600 pixels are",
        **_own("image_scale", usual_image_scale),
    )
    holdout: choice(
        "Leave Out",
        "What is not trained on, so that quality can be measured on it",
        HOLDOUTS,
        get=lambda settings: 2 if settings.holdout_frames > 0 else settings.holdout_frames + 1,
        set=_set_holdout,
        options={"SKIP_SAVE"},
    )
    has_max_gaussians: switch(
        "Limit Gaussians", "Limit the number of Gaussians of the scene", **_own("max_gaussians", usual_gaussians)
    )


def _properties() -> dict[str, Any]:
    """By name, those that stand for options: as the table has them, with what the panel knows besides."""
    more: dict[str, dict[str, Any]] = {
        "seconds": {"soft_max": 600.0, "precision": 1, "step": 50},
        "scale": {"max": 1.0},
        "max_gaussians": {"soft_max": 1_000_000},
        "masks": {"items": MASKS},
        "layout": {"update": lambda settings, _: capture_reading.read(bpy.path.abspath(settings.capture_folder))},
        "preview_camera": {"search": camera_names, "update": _on_preview_camera},
    }
    options = [option for option in panel_options() if property_name(option) not in _OWN]
    return {property_name(option): property_of(option, **more.get(option.name, {})) for option in options}


_OWN = frozenset(TrainingSettings.__annotations__)
"""Properties that are written out."""
TrainingSettings.__annotations__.update(_properties())
