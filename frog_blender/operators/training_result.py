"""What becomes of a training's scene when it ends: it joins the scene that asked for it, and changes nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from ..engine.errors import FrogError
from ..scene_import.capture_objects import known_by, plays
from ..scene_import.create_objects import import_scene
from ..scene_import.scene_setup import is_untouched
from ..timeline import playback


def importer(scene: Any) -> Callable[[Path], str]:
    """A function that takes a finished file into ``scene``, once, as a step of its own that undo takes back.

    It returns what the panel is to say besides, "" where all went as one expects. Where the scene is gone or is being
    edited it leaves the file to the panel's *Import*. It may raise FrogError.
    """
    uid, name, file = scene.session_uid, scene.name, bpy.data.filepath

    def show(path: Path) -> str:
        target = known_by(bpy.data.scenes, uid)  # whatever it is called by now
        if target is None and file and bpy.data.filepath == file:  # the same file, opened again
            target = bpy.data.scenes.get(name)
        if target is None:
            return "Not imported by itself: the scene that it was trained for was not open when the training ended."
        if plays(target, path):
            playback.refresh(target)
            return ""
        if _is_being_edited(target):
            return "Not imported by itself: the scene was being edited when the training ended."
        untouched, others = is_untouched(target), _of_same_capture(target, path)
        import_scene(path, target, set_up_scene=untouched, use_frog_engine=untouched)
        _remember_step()
        if others:
            return f"Imported beside {', '.join(others)} of the same capture: hide one of them."
        return "" if untouched else "Imported; the scene's settings stayed as they were."

    return show


def _is_being_edited(scene: Any) -> bool:
    """Whether a mode other than Object Mode is on, whose own undo steps an import would mix with."""
    active = (layer.objects.active for layer in scene.view_layers)
    return any(obj is not None and obj.mode != "OBJECT" for obj in active)


def _of_same_capture(scene: Any, path: Path) -> list[str]:
    """The names of the files that the scene plays and that were trained from the same capture as this one."""
    capture = playback.open_scene(path).header.capture_path
    found = []
    for obj in playback.captures(scene.objects):
        try:
            header = playback.open_scene(playback.file_of(obj)).header
        except FrogError:  # the panel says so beside that capture
            continue
        if capture and header.capture_path == capture:
            found.append(playback.file_of(obj).name)
    return found


def _remember_step() -> None:
    """Ends a step of undo, so that one undo takes back the import, and only it."""
    if bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.ed.undo_push(message="Import trained FRoG scene")
