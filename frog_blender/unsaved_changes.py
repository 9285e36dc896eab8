"""The open file while work goes on beside it: it counts as unsaved, and no operation in it is disturbed."""

import bpy

_JOBS = ("RENDER", "OBJECT_BAKE")  # jobs of Blender that read the scene in their own threads


def is_scene_in_use(besides: bpy.types.Operator | None = None) -> bool:
    """Whether a render or an operation, other than the operator ``besides``, works on a scene."""
    return any(map(bpy.app.is_job_running, _JOBS)) or is_being_changed(besides)


def is_being_changed(besides: bpy.types.Operator | None = None) -> bool:
    """Whether the user is in the middle of something that can be undone, such as moving an object with the mouse.

    An operator that ``is_waiting`` has changed nothing yet.
    """
    running = (operator for window in bpy.context.window_manager.windows for operator in window.modal_operators)
    changing = (operator for operator in running if operator != besides and not getattr(operator, "is_waiting", False))
    return any("UNDO" in operator.bl_options for operator in changing)


def is_being_edited(scene: bpy.types.Scene) -> bool:
    """Whether a mode other than Object Mode is active. An import would mix with its undo steps."""
    active = (layer.objects.active for layer in scene.view_layers)
    return any(obj is not None and obj.mode != "OBJECT" for obj in active)


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
