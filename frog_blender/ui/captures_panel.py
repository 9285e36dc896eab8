"""The Scene panel of the FRoG tab: the captures of this scene, and what the chosen one plays."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from pathlib import Path
from typing import Any

import bpy

from .. import capture_files, point_cloud
from ..properties import whole
from ..relative_paths import library_of
from ..scene_import.capture_objects import active_capture, cameras_of, root_of, select_capture
from ..timeline import open_scenes, playback, playback_cache, retiming
from ..viewport import drawing
from . import refreshing
from .sidebar_panel import SidebarPanel, SubPanel, split, wrapped_label


def chosen_capture(context: bpy.types.Context) -> Any:  # Any: None without any
    """The capture that panels are about: the active one, otherwise the scene's first, otherwise None."""
    return active_capture(context) or next(playback.captures(context.scene.objects), None)


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
        problem = retiming.problem(item, context.scene.frame_current_final)
        problem = problem or open_scenes.problem(playback.file_of(item))
        layout.label(text=root_of(item).name, icon="ERROR" if problem else "OUTLINER_OB_POINTCLOUD")
        row = layout.row(align=True)
        row.prop(item, "hide_viewport", text="", emboss=False)
        row.prop(item, "hide_render", text="", emboss=False)

    def filter_items(self, _context: bpy.types.Context, data: Any, name: str) -> tuple[list[int], list[int]]:
        captures = set(playback.captures(data.objects))
        shown = [self.bitflag_filter_item if obj in captures else 0 for obj in getattr(data, name)]
        return shown, []


class FROG_PT_captures(SidebarPanel, bpy.types.Panel):
    """The captures of this scene."""

    bl_label = "Scene"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("import_scene.frog", icon="IMPORT")
        captures = list(playback.captures(context.scene.objects))
        if len(captures) > 1:
            settings = context.scene.frog
            layout.template_list("FROG_UL_captures", "", context.scene, "objects", settings, "capture_index", rows=3)
        said: set[str] = set()
        for obj in captures:
            if outdated(obj):
                refreshing.soon()
            _draw_problem(layout, obj, context, said)
        wrapped_label(layout, drawing.problem(context.scene), icon="INFO")
        chosen = chosen_capture(context)
        if chosen is None:
            return
        layout.prop(chosen.frog, "filepath", text="")
        if not open_scenes.problem(playback.file_of(chosen)):
            packed = capture_files.packed_bytes(chosen) / playback_cache.MEGABYTE
            text = " at this frame" if len(chosen.frog_edits.crops) else ""
            text += f", packed into the .blend ({packed:,.1f} MB)" if packed else ""
            number = point_cloud.count_shown(chosen) if len(chosen.frog_edits.crops) else point_cloud.count(chosen)
            layout.label(text=f"{number:,} Gaussians{text}", icon="OUTLINER_OB_POINTCLOUD")
        layout.operator("frog.align_to_floor", icon="GRID")
        if context.object is not None and context.object.type == "CAMERA":
            layout.operator("frog.look_through", icon="VIEW_CAMERA")
        if cameras_of(chosen):
            row = layout.row(align=True)
            row.operator("frog.add_clips", icon="FILE_MOVIE")
            row.operator("frog.hide_clips", text="Hide", icon="HIDE_ON")


def _file(context: bpy.types.Context) -> Path:
    """Of the chosen capture."""
    return playback.file_of(chosen_capture(context))


class OfCaptures:
    """Base of panels about scenes with captures."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return playback.has_captures(context.scene)


class OfChosen(SubPanel):
    """Base of sub-panels about the chosen capture."""

    bl_parent_id = "FROG_PT_captures"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return chosen_capture(context) is not None and not open_scenes.problem(_file(context))


class OfMoving(OfChosen):
    """The same for one that has several frames."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and playback.open_scene(_file(context)).header.frame_count > 1


class FROG_PT_display(OfChosen, bpy.types.Panel):
    """How other engines and shading modes show the chosen capture."""

    bl_label = "Display"

    def draw(self, context: bpy.types.Context) -> None:
        layout, chosen = split(self.layout), chosen_capture(context)
        layout.prop(context.scene.frog, "viewport_drawing")
        layout.prop(chosen.frog, "density", text="Density", slider=True)
        layout.prop(chosen.frog, "render_density", text="In Renders", slider=True)


def _draw_problem(
    layout: bpy.types.UILayout, obj: bpy.types.Object, context: bpy.types.Context, said: set[str]
) -> None:
    """Draws why a capture does not play, and what finds its file, unless a duplicate of it has ``said`` so."""
    file = playback.file_of(obj)
    error, is_new = open_scenes.problem(file), False
    for sentence in (retiming.problem(obj, context.scene.frame_current_final), error):
        if is_new := sentence not in said:
            wrapped_label(layout, sentence, icon="ERROR")
        said.add(sentence)
    if error and is_new and open_scenes.is_missing(file) and library_of(obj) is None:
        layout.operator("file.find_missing_files", icon="FILE_FOLDER")


def outdated(obj: bpy.types.Object) -> bool:
    """Whether a capture's file has changed since it was read. Linked captures are never read here."""
    is_linked = obj.data.library is not None or obj.data.override_library is not None
    return not is_linked and open_scenes.is_outdated(playback.file_of(obj))
