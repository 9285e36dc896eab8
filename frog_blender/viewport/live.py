"""A training's scene in the viewports while it runs."""

import bpy
import numpy as np

from .. import addon_state
from ..scene_import.capture_objects import of_same_capture
from ..tasks.training import TrainingTask, Watchers
from ..timeline.playback_cache import SceneTime
from . import drawing
from .picture import Shown

START_FRAME = 1.0
"""Of the timeline, at which a capture's first image is shown, as when it is imported."""


def shown_in(scene: bpy.types.Scene) -> Shown | None:
    """The running training's scene at the current frame; None where the scene plays a result of that capture."""
    task = TrainingTask.current()
    player = task.live.shown_in(scene) if task is not None and task.live is not None else None
    if player is None or of_same_capture(scene, player.header.capture_path):
        return None
    time = player.time_of(scene.frame_current_final - START_FRAME)
    return Shown(SceneTime(player, time), np.eye(4))


def register() -> None:
    if bpy.app.background:  # nothing is drawn, and there may be no graphics
        return
    drawing.state().source = shown_in
    addon_state.get(Watchers).of_scene.append(drawing.changed)
