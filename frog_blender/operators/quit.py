"""Ctrl-Q while something runs: Blender itself asks for unsaved changes of the file alone."""

import bpy

from ..tasks import background_task
from .bases import ConfirmedOperator


class FROG_OT_quit(ConfirmedOperator, bpy.types.Operator):
    """Quit Blender, and end what runs in the background"""

    bl_label = "Quit Blender"

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        return "" if background_task.running() else "Nothing runs in the background."

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        type(self).question = " ".join(background_task.at_quitting())
        return super().invoke(context, event)

    def act(self, _context: bpy.types.Context) -> None:
        bpy.ops.wm.quit_blender("INVOKE_DEFAULT")


def _keys() -> bpy.types.KeyMapItems | None:
    """Where add-ons put keys of every editor; None without a window."""
    keys = bpy.context.window_manager.keyconfigs.addon
    return None if keys is None else keys.keymaps.new(name="Window", space_type="EMPTY").keymap_items


def register() -> None:
    if (keys := _keys()) is not None:  # where it does not apply, the key is Blender's
        keys.new(FROG_OT_quit.bl_idname, "Q", "PRESS", ctrl=True)


def unregister() -> None:
    if (keys := _keys()) is not None:
        for item in [item for item in keys if item.idname == FROG_OT_quit.bl_idname]:
            keys.remove(item)
