"""What belongs to an imported capture: its Gaussians, its root, its cameras. Found from any of them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import bpy

from ..engine.errors import FrogError
from ..relative_paths import seen_from
from ..timeline import playback


def chosen(context: Any) -> Any:
    """The Gaussians of the capture that the active object belongs to, else of the scene's only one, else None."""
    active = context.object
    while active is not None:
        of_it = next(playback.captures([active, *active.children]), None)
        if of_it is not None:
            return of_it
        active = active.parent
    captures = list(playback.captures(context.scene.objects))
    return captures[0] if len(captures) == 1 else None


def named_or_chosen(context: Any, name: str) -> Any:
    """The capture of that name in this file, for no name the chosen one; FrogError where there is none to change."""
    if not name:
        obj = chosen(context)
        name = obj.name if obj is not None else ""
    found = next((obj for obj in playback.captures(bpy.data.objects) if obj.name == name and obj.library is None), None)
    if found is None:
        raise FrogError(f"{name or 'No object'}: found no such capture in this file, expected one that plays a .frog.")
    return found


def known_by(blocks: Any, uid: int) -> Any:
    """The data-block of that session_uid, which no renaming or undo changes; None where it is gone."""
    return next((block for block in blocks if block.session_uid == uid), None)


def select_alone(context: Any, obj: Any) -> None:
    """Make an object the only selected one, and the active one."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def placed_by(obj: Any) -> Any:
    """What is moved to move a capture as a whole: the empty that it hangs on, or its Gaussians without one."""
    return obj.parent if obj.parent is not None else obj


def cameras_of(obj: Any) -> list[Any]:
    """The camera objects of a capture, whose cameras saw it where it is now."""
    return [child for child in placed_by(obj).children if child.type == "CAMERA"] if obj.parent is not None else []


def plays(scene: Any, path: Path) -> bool:
    """Whether a capture of the scene plays this file."""
    wanted = Path(os.path.normpath(path))
    return any(playback.file_of(obj) == wanted for obj in playback.captures(scene.objects))


def stored_path(path: Path) -> str:
    """The path as a .blend keeps it: from its own folder, if that is what the user's other paths do.

    A script's may begin at the current folder, which no .blend knows.
    """
    absolute = os.path.abspath(path)
    if not (bpy.data.filepath and bpy.context.preferences.filepaths.use_relative_paths):
        return absolute
    return seen_from(Path(bpy.data.filepath).parent, absolute)
