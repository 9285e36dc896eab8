"""The open file during a training: it counts as unsaved, and is not touched in the middle of an operation."""

from __future__ import annotations

import bpy


def is_being_changed() -> bool:
    """Whether the user is in the middle of something that can be undone, such as moving an object with the mouse."""
    manager = bpy.context.window_manager
    return any("UNDO" in operator.bl_options for window in manager.windows for operator in window.modal_operators)


def count_as_unsaved() -> None:
    """Make Blender ask before it quits or opens another file, until the file is saved again; nothing in it changes.

    It costs a step of undo in which nothing happens. It must not cost what the user could redo: a file that was saved
    after an undo stays saved until something new is done in it.
    """
    windows = bpy.context.window_manager.windows
    if bpy.data.is_dirty or not windows or is_being_changed():
        return
    with bpy.context.temp_override(window=windows[0]):
        if bpy.ops.ed.redo.poll():  # a push would discard the redo steps
            return
        bpy.ops.ed.undo_push(message="FRoG training")  # Blender has no other way to mark a file as changed
