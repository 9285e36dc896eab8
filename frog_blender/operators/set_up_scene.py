"""Set Up Scene, as an option of importers and as an operator; colours as filmed; Look Through Camera."""

# mypy: disable-error-code="valid-type"

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import bpy
from bpy.props import BoolProperty

from ..engine.errors import FrogError
from ..scene_import.capture_objects import active_capture, cameras_of
from ..scene_import.scene_setup import (
    PARTS,
    are_colors_unchanged,
    frame_range,
    is_untouched,
    look_through,
    set_up,
    show_colors_unchanged,
)
from ..scene_import.transaction import all_or_nothing
from ..timeline import playback


class SetsUpScene:
    """Base of importers: two properties that decide what else of the scene changes.

    Left alone they are on where the scene holds nothing of the user's, else off. They are not remembered from one
    import to the next, because the next scene is another.
    """

    set_up_scene: BoolProperty(
        name="Set Up Scene",
        description="Use the capture's frame range, frame rate, image size, camera and background, and show its "
        "colors unchanged (Standard view transform, no dithering). Enabled by default in a new file only",
        default=True,
        options={"SKIP_SAVE"},
    )
    use_frog_engine: BoolProperty(
        name="Render with FRoG",
        description="Make FRoG the scene's render engine, which draws the captures as they were trained, and show "
        "rendered viewports. Enabled by default in a new file only",
        default=True,
        options={"SKIP_SAVE"},
    )

    _decided: Mapping[str, bool] = MappingProxyType({})
    """What ``decide`` has set."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Shows the properties with this scene's defaults."""
        self.decide(context.scene)
        result: set[str] = super().invoke(context, event)  # type: ignore[misc]  # of the importer's other base
        return result

    def decide(self: Any, scene: bpy.types.Scene) -> bool:
        """Sets both properties, unless they were given. Returns whether the settings stay unchanged by default."""
        given, untouched = self.properties.is_property_set, is_untouched(scene)
        left_alone = not given("set_up_scene") and not untouched
        decided = dict(self._decided)
        if not given("set_up_scene"):
            self.set_up_scene = decided["set_up_scene"] = untouched
        if not given("use_frog_engine"):
            self.use_frog_engine = decided["use_frog_engine"] = untouched or self.set_up_scene
        self._decided = decided
        return left_alone

    def wanted(self: Any, scene: bpy.types.Scene) -> tuple[bool, bool]:
        """Both properties, long after ``decide``: on only where the user chose so, or where the scene still holds
        nothing of the user's.
        """
        untouched = is_untouched(scene)

        def is_chosen(name: str) -> bool:
            return getattr(self, name) != self._decided.get(name)

        sets_up = self.set_up_scene and (untouched or is_chosen("set_up_scene"))
        return sets_up, self.use_frog_engine and (untouched or sets_up or is_chosen("use_frog_engine"))


class ChoosesParts:
    """Base of an operator: which parts of the scene are matched to a capture, see ``scene_setup.PARTS``."""

    use_frames: BoolProperty(name="Frame Range", description="Begin and end with the capture", default=True)
    use_rate: BoolProperty(name="Frame Rate", description="Play as fast as it was filmed", default=True)
    use_size: BoolProperty(name="Image Size", description="Render at the size of the capture's images", default=True)
    use_camera: BoolProperty(name="Camera", description="Render through the capture's first camera", default=True)
    use_colors: BoolProperty(
        name="Colors as Filmed",
        description="Show the colors of the videos unchanged: Standard view transform, no look and no dithering",
        default=True,
    )
    use_background: BoolProperty(
        name="Background", description="A world of the color behind the capture. The present one is kept", default=True
    )
    use_engine: BoolProperty(
        name="Render with FRoG", description="Make FRoG the render engine, and show rendered viewports", default=True
    )

    @property
    def parts(self) -> list[str]:
        """The chosen ones."""
        return [part for part in PARTS if getattr(self, f"use_{part}")]


class FROG_OT_set_up_scene(ChoosesParts, bpy.types.Operator):
    """Match the scene to the capture: frame range, frame rate, image size, camera, background and colors"""

    bl_idname = "frog.set_up_scene"
    bl_label = "Set Up Scene"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Select one of the scene's captures first.")
        return active_capture(context) is not None

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

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj, scene = active_capture(context), context.scene
        try:
            header = playback.open_scene(playback.file_of(obj)).header
            with all_or_nothing(scene):
                set_up(scene, header, obj.frog.start_frame, cameras_of(obj), self.parts)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def _values(obj: bpy.types.Object) -> dict[str, str]:
    """What parts of a scene become, in words, where that can be said."""
    try:
        header = playback.open_scene(playback.file_of(obj)).header
    except FrogError:
        return {}
    found: dict[str, str] = {}
    if header.frame_count > 1:
        first, last = frame_range(header, obj.frog.start_frame)
        found |= {"frames": f"{first} to {last}", "rate": f"{header.frames_per_second:g} per second"}
    if cameras := cameras_of(obj):
        width, height = cameras[0].data.frog.size
        found |= {"size": f"{width} x {height} pixels", "camera": cameras[0].name}
    return found


class FROG_OT_show_as_filmed(bpy.types.Operator):
    """Show the colors of the videos unchanged: Standard view transform, no look and no dithering. It holds for \
everything in the scene"""

    bl_idname = "frog.show_as_filmed"
    bl_label = "Show Colors as Filmed"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("The scene shows colors as they were filmed already.")
        return not are_colors_unchanged(context.scene)

    def execute(self, context: bpy.types.Context) -> set[str]:
        show_colors_unchanged(context.scene)
        if not are_colors_unchanged(context.scene):
            self.report({"ERROR"}, "Blender's color configuration was replaced: it has no Standard view transform.")
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_look_through(bpy.types.Operator):
    """Make the selected camera active and render at the size of its captured images"""

    bl_idname = "frog.look_through"
    bl_label = "Look Through Camera"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Select a camera first.")
        return context.object is not None and context.object.type == "CAMERA"

    def execute(self, context: bpy.types.Context) -> set[str]:
        look_through(context.scene, context.object)
        return {"FINISHED"}


_CLASSES = (FROG_OT_set_up_scene, FROG_OT_show_as_filmed, FROG_OT_look_through)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
