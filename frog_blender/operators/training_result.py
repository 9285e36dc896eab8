"""Imports the scene of a finished training into the scene that it was started from."""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import point_cloud
from ..scene_import.capture_objects import finder, of_same_capture, plays
from ..scene_import.create_objects import import_scene
from ..timeline import playback
from ..unsaved_changes import is_being_edited


class ResultImporter:
    """Imports a finished file into ``scene`` once, as one undo step: call it with the file's path.

    It adds the capture and changes nothing else: no viewport, no selection, no setting, which the panel offers. It
    returns what the panel is to say besides, "" where all went as one expects. Where the scene is gone or is being
    edited it leaves the file to the panel's *Import*. It may raise FrogError.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self._find = finder(scene)

    def prepare(self) -> None:
        """Makes what any import needs, at another time than the rest; nothing where none would follow."""
        target = self._find()
        if target is not None and not is_being_edited(target):
            point_cloud.prepare()

    def __call__(self, path: Path) -> str:
        target = self._find()
        if target is None:
            return "Not imported automatically: the scene that it was trained for was not open when the training ended."
        if plays(target, path):
            playback.refresh(target)
            return ""
        if is_being_edited(target):
            return "Not imported automatically: the scene was being edited when the training ended."
        others = of_same_capture(target, playback.open_scene(path).header.capture_path)
        import_scene(path, target, set_up_scene=False, use_frog_engine=False)
        _remember_step()
        if others:
            return f"Imported beside {', '.join(others)} of the same capture. Hide one of them."
        return ""


def _remember_step() -> None:
    """Pushes an undo step, so that one undo reverts the import and nothing else."""
    if bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.ed.undo_push(message="Import trained FRoG scene")
