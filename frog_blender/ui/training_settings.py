"""Settings on scenes: what to train, and how."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from pathlib import Path
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    FloatProperty,
    FloatVectorProperty,
    PointerProperty,
    StringProperty,
)

from .. import redrawing, relative_paths
from ..engine.options import OPTIONS, Door, options_at
from ..engine.training.session.output_paths import free_output
from ..option_properties import items_of, property_name, property_of
from ..relative_paths import PATH_OPTIONS
from ..tasks.training_request import KEY_MASKS, REMOTE
from .rig_settings import FrogRigSettings
from .training_choices import TrainingChoices

DEVICES = (
    *items_of(OPTIONS["device"]),
    (REMOTE, "Remote", "Another computer, by the Remote Command in the add-on's preferences"),
)
_FOLDER, *_OTHERS = items_of(OPTIONS["masks"])
MASKS = (_FOLDER, (KEY_MASKS, "Key Colour", "The same, and a backdrop of one colour is not learned"), *_OTHERS)


def _on_capture_folder(settings: Any, _context: bpy.types.Context) -> None:
    if relative_paths.are_being_written():
        return
    from . import capture_reading  # imported late, as this imports the readers

    capture_reading.read(bpy.path.abspath(settings.capture_folder))
    if settings.capture_folder and settings.output_path in ("", settings.derived_output):
        folder = Path(bpy.path.abspath(settings.capture_folder))
        settings.derived_output = settings.output_path = str(free_output(Path(f"{folder}.frog"), folder))


def camera_names(settings: Any, _context: bpy.types.Context, text: str) -> list[str]:
    """Search suggestions for the preview camera."""
    from . import capture_summary

    summary = capture_summary.known(bpy.path.abspath(settings.capture_folder))
    return [name for name in summary.cameras if text.lower() in name.lower()] if summary else []


def _on_show_rig(_settings: Any, _context: bpy.types.Context) -> None:
    redrawing.viewports()


def _on_preview_camera(settings: Any, _context: bpy.types.Context) -> None:
    from ..tasks.training import TrainingTask

    task = TrainingTask.current()
    if task is not None:
        task.control.preview_camera = settings.preview_camera


class TrainingSettings(TrainingChoices):
    """A base of ``Scene.frog``: what to train, and how."""

    rig: PointerProperty(type=FrogRigSettings)

    capture_folder: StringProperty(
        name="Capture",
        description="Folder with the videos or images and their camera calibration",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
        update=_on_capture_folder,
    )
    output_path: StringProperty(
        name="Output",
        description="The .frog scene file that training writes",
        subtype="FILE_PATH",
        options=PATH_OPTIONS,
    )
    derived_output: StringProperty(
        name="Derived Output",
        description="The output path derived from the capture's name. It follows the capture as long as the output "
        "is not changed by hand",
        options={"HIDDEN"},
    )
    key_color: FloatVectorProperty(
        name="Key Colour",
        description="Colour of the backdrop",
        subtype="COLOR_GAMMA",
        size=3,
        min=0.0,
        max=1.0,
        default=(0.0, 177 / 255, 64 / 255),
    )
    key_tolerance: FloatProperty(
        name="Tolerance",
        description="How much less of the key colour than its own a pixel of the backdrop may have, in shadows for "
        "example",
        min=0.0,
        max=0.95,
        default=0.4,
    )
    show_rig: BoolProperty(
        name="Draw Rig",
        description="Draw the capture's cameras into the viewport until a scene of it is imported",
        default=True,
        update=_on_show_rig,
    )
    show_live: BoolProperty(
        name="Show in Viewports",
        description="Show the scene in the viewports while it is trained. It takes 2 % of the training's time",
        default=True,
        update=_on_show_rig,
    )
    import_when_done: BoolProperty(
        name="Import When Done",
        description="Import the trained scene into this one as soon as it is finished. Settings of a scene that you "
        "have changed are not touched",
        default=True,
    )


def _properties() -> dict[str, Any]:
    """By name, those that stand for options: as the table has them, with what the panel knows besides."""
    more: dict[str, dict[str, Any]] = {
        "seconds": {"soft_max": 600.0, "precision": 1, "step": 50},
        "scale": {"max": 1.0},
        "max_gaussians": {"soft_max": 1_000_000},
        "device": {"items": DEVICES},
        "masks": {"items": MASKS},
        "preview_camera": {"search": camera_names, "update": _on_preview_camera},
    }
    options = [option for option in options_at(Door.PANEL) if property_name(option) not in _OWN]
    return {property_name(option): property_of(option, **more.get(option.name, {})) for option in options}


_OWN = frozenset(TrainingSettings.__annotations__)
"""Properties that are written out."""
TrainingSettings.__annotations__.update(_properties())
