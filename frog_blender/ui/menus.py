"""Entries in Blender's own menus, where its search (F3) finds them as well."""

import bpy

from .. import edition
from ..scene_import.capture_objects import active_capture
from ..viewport import hiding


class FROG_MT_object(bpy.types.Menu):
    """What can be done with a capture."""

    bl_label = "FRoG"

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("frog.align_to_floor", icon="GRID")
        layout.operator("frog.add_clips", icon="FILE_MOVIE")
        layout.operator("frog.hide_clips")
        layout.operator("frog.look_through", icon="VIEW_CAMERA")
        layout.separator()
        layout.operator("frog.set_up_scene", icon="SCENE_DATA")
        layout.operator("frog.show_as_filmed", icon="COLOR")
        layout.operator_menu_enum("frog.compose", "engine", icon="NODE_COMPOSITING")
        layout.operator("frog.light_objects", icon="WORLD")
        layout.operator("frog.use_own_world")
        layout.operator("frog.make_proxy", icon="MESH_DATA")
        layout.separator()
        timing = ("timing_to_curve", "fit_frame_range", "play_in_real_time")
        for name in (*timing, "add_sound_strip", "update_sound"):
            layout.operator(f"frog.{name}")
        if edition.TRAINS:
            layout.separator()
            layout.operator("frog.train", icon="PLAY")
            layout.operator("frog.train_longer")


def _object(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.menu(FROG_MT_object.__name__)


def _context_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    if active_capture(context) is not None:
        _object(self, context)


def _add(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.operator("import_scene.frog", text="FRoG Scene", icon="OUTLINER_OB_POINTCLOUD")
    if edition.TRAINS:
        self.layout.operator("import_scene.frog_capture", text="FRoG Capture to Train From", icon="FILE_MOVIE")


def _render(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.operator_menu_enum("frog.compose", "engine", text="FRoG Captures With My Objects")
    self.layout.operator("frog.render_film", text="FRoG Film")


def _undrawn(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Says in a viewport's header which objects FROG's picture lacks, and shows them at a click."""
    if lacking := hiding.undrawn(context):
        self.layout.operator("frog.compose", text=f"{lacking}: Render With My Objects", icon="INFO")


MENUS = {
    "VIEW3D_MT_editor_menus": _undrawn,
    "VIEW3D_MT_object": _object,
    "VIEW3D_MT_object_context_menu": _context_menu,
    "VIEW3D_MT_add": _add,
    "TOPBAR_MT_render": _render,
}
