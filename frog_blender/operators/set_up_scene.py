"""Set Up Scene, colours as filmed, Look Through Camera."""

# mypy: disable-error-code="valid-type"

import bpy

from ..engine.errors import FrogError
from ..properties import switch
from ..scene_import.capture_objects import active_capture, cameras_of
from ..scene_import.scene_setup import (
    PARTS,
    all_or_nothing,
    are_colors_unchanged,
    frame_range,
    look_through,
    set_up,
    show_colors_unchanged,
)
from ..timeline import playback
from ..viewport import views
from .bases import UndoableOperator


class FROG_OT_set_up_scene(UndoableOperator, bpy.types.Operator):
    """Match the scene to the capture: frame range, frame rate, image size, camera, background and colours"""

    bl_label = "Set Up Scene"
    needs_capture = True

    # As ``scene_setup.PARTS``.
    use_frames: switch("Frame Range", "Begin and end with the capture", True)
    use_rate: switch("Frame Rate", "Play as fast as it was filmed", True)
    use_size: switch("Image Size", "Render at the size of the capture's images", True)
    use_camera: switch("Camera", "Render through the capture's first camera", True)
    use_colors: switch(
        "Colors as Filmed",
        "Show the colours of the videos unchanged: Standard view transform, no look and no dithering",
        True,
    )
    use_background: switch("Background", "A world of the colour behind the capture. The present one is kept", True)
    use_engine: switch("Render with FRoG", "Make FRoG the render engine, and show rendered viewports", True)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, title="Match the Scene to the Capture?")

    def draw(self, context: bpy.types.Context) -> None:
        obj = active_capture(context)
        said = _values(obj) if obj is not None else {}
        for part in PARTS:
            row = self.layout.row()
            row.prop(self, f"use_{part}")
            if part in said:
                row.label(text=said[part])

    def act(self, context: bpy.types.Context) -> None:
        obj, scene = active_capture(context), context.scene
        header = playback.open_scene(playback.file_of(obj)).header
        parts = [part for part in PARTS if getattr(self, f"use_{part}")]
        with all_or_nothing(scene):
            set_up(scene, header, obj.frog.start_frame, cameras_of(obj), parts)
        views.count_as_untouched()


def _values(obj: bpy.types.Object) -> dict[str, str]:
    """What parts of a scene become, in words, where that can be said."""
    try:
        header = playback.open_scene(playback.file_of(obj)).header
    except FrogError:
        return {}
    said: dict[str, str] = {}
    if header.frame_count > 1:
        first, last = frame_range(header, obj.frog.start_frame)
        said |= {"frames": f"{first} to {last}", "rate": f"{header.frames_per_second:g} per second"}
    if cameras := cameras_of(obj):
        width, height = cameras[0].data.frog.size
        said |= {"size": f"{width} x {height} pixels", "camera": cameras[0].name}
    return said


class FROG_OT_show_as_filmed(UndoableOperator, bpy.types.Operator):
    """Show the colours of the videos unchanged: Standard view transform, no look and no dithering. It holds for \
everything in the scene"""

    bl_label = "Show Colors as Filmed"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "The scene shows colours as they were filmed already." if are_colors_unchanged(context.scene) else ""

    def act(self, context: bpy.types.Context) -> None:
        show_colors_unchanged(context.scene)
        if not are_colors_unchanged(context.scene):
            raise FrogError("Blender's colour configuration was replaced: it has no Standard view transform.")


class FROG_OT_look_through(UndoableOperator, bpy.types.Operator):
    """Make the selected camera active and render at the size of its captured images"""

    bl_label = "Look Through Camera"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        is_camera = context.object is not None and context.object.type == "CAMERA"
        return "" if is_camera else "Select a camera first."

    def act(self, context: bpy.types.Context) -> None:
        look_through(context.scene, context.object)
