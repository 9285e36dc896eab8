"""The objects of an imported capture: its Gaussians, its root and its cameras, found from any of them."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy

from ..engine.errors import FrogError
from ..relative_paths import seen_from
from ..timeline import playback

HOLDS_CAMERAS = "frog_holds_cameras"
"""A custom property of what stands between a capture's root and its cameras; another capture's root may stand there
as well.
"""

MADE_AS = "frog_made_as"
"""A custom property of what an import made: its name then. A duplicate has another name."""


def active_capture(context: bpy.types.Context) -> Any:  # Any: None as well, which operators exclude by poll
    """The capture that the active object belongs to, otherwise the scene's only capture, otherwise None."""
    active = context.object
    while active is not None:
        of_it = next(playback.captures([active, *active.children]), None)
        if of_it is not None:
            return of_it
        active = active.parent
    captures = list(playback.captures(context.scene.objects))
    return captures[0] if len(captures) == 1 else None


def find_by_uid(blocks: Any, uid: int) -> Any:
    """The data-block with that session_uid, which renaming and undo do not change; None if it is gone."""
    return next((block for block in blocks if block.session_uid == uid), None)


def finder(scene: bpy.types.Scene) -> Callable[[], bpy.types.Scene | None]:
    """A function that finds a scene again later: renamed as well, and by its name where its file was opened again. In
    another file it finds none.
    """
    uid, name, file = scene.session_uid, scene.name, bpy.data.filepath

    def find() -> bpy.types.Scene | None:
        known: bpy.types.Scene | None = find_by_uid(bpy.data.scenes, uid)
        return bpy.data.scenes.get(name) if known is None and file and bpy.data.filepath == file else known

    return find


def select_capture(context: bpy.types.Context, obj: bpy.types.Object, *, extend: bool = False) -> None:
    """Makes what moves a capture the active object, and selects its Gaussians with it: so duplicating and deleting
    reach them. They stay where they are in it, as their own place is locked and their parent moves.
    """
    select_only(context, root_of(obj), extend=extend)
    if obj.name in context.view_layer.objects:
        obj.select_set(True)


def select_only(context: bpy.types.Context, obj: bpy.types.Object, *, extend: bool = False) -> None:
    """Makes an object the active one, and the only selected one unless the selection is extended."""
    for other in () if extend else context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def root_of(obj: bpy.types.Object) -> bpy.types.Object:
    """The object that places a capture: the parent of its Gaussians, or these without a parent."""
    return obj.parent if obj.parent is not None else obj


def cameras_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """The camera objects of a capture."""
    return [child for holder in holders_of(obj) for child in holder.children if child.type == "CAMERA"]


def holders_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """What stands between a capture's root and its cameras."""
    return [child for child in obj.parent.children if HOLDS_CAMERAS in child] if obj.parent is not None else []


def is_as_made(block: Any) -> bool:  # Any: an object or a collection
    """Whether an import made it, and nobody has named or duplicated it since."""
    return bool(block.get(MADE_AS) == block.name)


def that_plays(scene: bpy.types.Scene, path: Path) -> bpy.types.Object | None:
    """The first capture of the scene that plays this file; None for none."""
    file = Path(os.path.normpath(path))
    return next((obj for obj in playback.captures(scene.objects) if playback.file_of(obj) == file), None)


def of_same_capture(scene: bpy.types.Scene, capture: str) -> list[str]:
    """Names of the files that a scene plays and that were trained from a capture, which headers call by this path."""
    names = []
    for obj in playback.captures(scene.objects) if capture else ():
        with suppress(FrogError):  # shown by the Scene panel
            if playback.open_scene(playback.file_of(obj)).header.capture_path == capture:
                names.append(playback.file_of(obj).name)
    return names


def stored_path(path: Path) -> str:
    """The path as stored in the .blend: relative to its folder if the user prefers relative paths.

    A script's may begin at the current folder, which no .blend knows.
    """
    absolute = os.path.abspath(path)
    if not (bpy.data.filepath and bpy.context.preferences.filepaths.use_relative_paths):
        return absolute
    return seen_from(Path(bpy.data.filepath).parent, absolute)
