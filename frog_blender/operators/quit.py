"""Ctrl-Q while something runs: Blender itself asks for unsaved changes of the file alone."""

import bpy

from ..registration import Keys
from ..tasks import background_task
from .bases import ConfirmedOperator


class FROG_OT_quit(ConfirmedOperator, bpy.types.Operator):
    """Quit Blender, and end what runs in the background"""

    bl_label = "Quit Blender"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks if anything runs. No ``poll`` does that: what runs may end before the question is answered."""
        if not background_task.running():
            return bpy.ops.wm.quit_blender("INVOKE_DEFAULT")
        type(self).question = " ".join(background_task.at_quitting())
        return super().invoke(context, event)

    def act(self, _context: bpy.types.Context) -> None:
        bpy.ops.wm.quit_blender("INVOKE_DEFAULT")


KEYMAPS: Keys = [("Window", FROG_OT_quit.bl_idname, "Q", "PRESS", {"ctrl": True})]
