"""The list of a scene's captures: one of them is chosen, and the panels below are about it."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy

from ..properties import whole
from ..scene_import.capture_objects import active_capture, root_of, select_capture
from ..timeline import open_scenes, playback, retiming


def chosen_capture(context: bpy.types.Context) -> Any:  # Any: None without any
    """The capture that panels are about: the active one, otherwise the scene's first, otherwise None."""
    return active_capture(context) or next(playback.captures(context.scene.objects), None)


def problem_of(obj: bpy.types.Object, frame: float) -> str:
    """Why a capture does not play at a frame, as a sentence; empty where it does."""
    return retiming.problem(obj, frame) or open_scenes.problem(playback.file_of(obj)) or ""


def _chosen_index(settings: Any) -> int:
    chosen = chosen_capture(bpy.context)
    objects = settings.id_data.objects
    return next((index for index, obj in enumerate(objects) if obj == chosen), -1)


def _choose(settings: Any, index: int) -> None:
    objects = settings.id_data.objects
    if 0 <= index < len(objects):
        chosen = objects[index]
        if root_of(chosen).name in bpy.context.view_layer.objects:  # its collection may be excluded
            select_capture(bpy.context, chosen)


class ChoosesCapture:
    """A base of ``Scene.frog``."""

    capture_index: whole(
        "Capture",
        "The chosen capture: an index into the scene's objects. Choosing one selects what moves it",
        get=_chosen_index,
        set=_choose,
        options={"SKIP_SAVE"},
    )


class FROG_UL_captures(bpy.types.UIList):
    """The captures among the scene's objects."""

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: bpy.types.Scene,
        item: bpy.types.Object,
        _icon: int,
        _active: Any,
    ) -> None:
        has_problem = bool(problem_of(item, context.scene.frame_current_final))
        layout.label(text=root_of(item).name, icon="ERROR" if has_problem else "OUTLINER_OB_POINTCLOUD")
        row = layout.row(align=True)
        row.prop(item, "hide_viewport", text="", emboss=False)
        row.prop(item, "hide_render", text="", emboss=False)

    def filter_items(self, _context: bpy.types.Context, data: Any, name: str) -> tuple[list[int], list[int]]:
        captures = set(playback.captures(data.objects))
        shown = [self.bitflag_filter_item if obj in captures else 0 for obj in getattr(data, name)]
        return shown, []


register, unregister = bpy.utils.register_classes_factory((FROG_UL_captures,))
