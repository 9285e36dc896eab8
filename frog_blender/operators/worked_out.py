"""Edits that take a while: worked out beside the main thread, and applied at once when that is done."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import bpy
import numpy as np

from .. import addon_state
from ..engine.editing.clean_up import CLUSTERS, LOOKING
from ..engine.editing.selections import cluster_sizes
from ..engine.errors import FrogError
from ..engine.playback.importance import camera_weights
from ..engine.playback.player import ScenePlayer
from ..relative_paths import being_written
from ..scene_import.capture_objects import active_capture, find_by_uid
from ..tasks.scene_work import SceneWork
from ..timeline import playback
from ..timeline.edited_scenes import EditedScenes
from .bases import EditOperator, scene_of
from .modal_operator import BesideUser, Steps

Tell: TypeAlias = Callable[[str, float], None]
"""Told a stage, and how much of it is done, 0 to 1."""
Work: TypeAlias = Callable[[Tell], Any]
"""What the worker thread calls."""


class WorkedOutEdit(BesideUser, EditOperator):
    """A base next to ``bpy.types.Operator``."""

    bl_options = {"UNDO"}  # not REGISTER: each change in the redo panel would work it out again, on the main thread
    doing = "{done} %"
    stopped = "The edit was stopped. Nothing has changed."
    at_once = 0.1
    plan: tuple[tuple[str, float], ...] = ()
    """Its stages, and the seconds that each is likely to take."""

    def work_out(self, context: bpy.types.Context, obj: bpy.types.Object, scene: ScenePlayer) -> Work:
        """What is called on the worker thread; its result is applied."""
        raise NotImplementedError

    def apply(self, context: bpy.types.Context, obj: bpy.types.Object, result: Any) -> str:
        """Changes the capture, and says what has changed."""
        raise NotImplementedError

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return super().problem(context) or (SceneWork.busy if SceneWork.is_any_running() else "")

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.is_interactive = True
        return self.execute(context)

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        obj = active_capture(context)
        task = SceneWork(self.work_out(context, obj, scene_of(obj)), self.plan).begin()
        return self._until_applied(task, obj.session_uid, obj.name), 100

    def _until_applied(self, task: SceneWork, uid: int, name: str) -> Steps:
        try:
            while task.is_running:
                self.pump(task)
                self.doing = f"{task.standing.stage}: {{done}} %"
                yield round(100 * task.standing.fraction)
        finally:
            task.cancel()
        if task.is_cancelled or task.error:
            raise FrogError(task.error or self.stopped)
        obj = find_by_uid(bpy.data.objects, uid)
        if obj is None:
            raise FrogError(f"{name}: this capture is no longer in the file.")
        with being_written():
            self.said = self.apply(bpy.context, obj, task.result)
        self.has_changed_file = True
        playback.refresh(bpy.context.scene)


def weights_of(scene: ScenePlayer, tell: Tell) -> np.ndarray:
    """(C, N) how much the cameras see of the Gaussians, found once for each scene."""
    made = addon_state.get(EditedScenes).made
    return made(scene, "weights", None, lambda _: camera_weights(scene, partial(tell, LOOKING)))


def cluster_sizes_of(scene: ScenePlayer, tell: Tell) -> np.ndarray:
    """(N,) how large the clusters of the Gaussians are, found once for each scene."""
    made = addon_state.get(EditedScenes).made
    return made(scene, "sizes", None, lambda _: cluster_sizes(scene, partial(tell, CLUSTERS)))
