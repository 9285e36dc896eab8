"""Edited scenes, made once for each state of their edits. Any thread may ask."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TYPE_CHECKING

from .. import addon_state

if TYPE_CHECKING:
    import numpy as np

    from ..engine.editing.closed_mesh import ClosedMesh
    from ..engine.editing.edited_scene import EditedScene
    from ..engine.editing.edits import Edits
    from ..engine.editing.marks import Marks
    from ..engine.playback.player import ScenePlayer

_SCENES_KEPT, _VALUES_KEPT = 4, 16


class EditedScenes:
    """What was made of the edits that were asked for last.

    Attributes:
        problems: sentences about edits that do not fit, by a scene's token.
    """

    def __init__(self) -> None:
        self.problems: dict[str, list[str]] = {}
        self._scenes: OrderedDict[tuple[str, Edits], EditedScene] = OrderedDict()
        self._marks: OrderedDict[tuple[int, str, str], Marks | None] = OrderedDict()
        self._meshes: OrderedDict[tuple[bytes, bytes], ClosedMesh | str] = OrderedDict()
        self._weights: tuple[str, np.ndarray] | None = None
        self._lock = threading.Lock()

    def of(self, scene: ScenePlayer, edits: Edits) -> ScenePlayer:
        """A scene with edits; as it is, if they change nothing of it."""
        from ..engine.editing.edited_scene import EditedScene

        key = scene.token, edits
        with self._lock:
            known = self._scenes.get(key)
            before = known or next((each for (token, _), each in self._scenes.items() if token == scene.token), None)
        if known is None:
            fitting, problems = edits.fitted(scene)
            self.problems[scene.token] = problems
            if fitting.are_none:
                return scene
            known = EditedScene(scene, fitting, before)
        with self._lock:
            self._scenes[key] = known
            self._scenes.move_to_end(key)
            while len(self._scenes) > _SCENES_KEPT:
                self._scenes.popitem(last=False)
        return known

    def marks(self, count: int, scene: str, text: str) -> Marks | None:
        """Marks from their text; None for damaged ones."""
        from ..engine.editing.marks import Marks

        key = count, scene, text
        if key not in self._marks:
            try:
                self._keep(self._marks, key, Marks.from_text(*key))
            except ValueError:
                self._keep(self._marks, key, None)
        return self._marks.get(key)

    def mesh(self, vertices: bytes, triangles: bytes) -> ClosedMesh | str:
        """A closed mesh; a phrase about one that is none."""
        from ..engine.editing.closed_mesh import ClosedMesh

        key = vertices, triangles
        if key not in self._meshes:
            try:
                self._keep(self._meshes, key, ClosedMesh(*key))
            except ValueError as error:
                self._keep(self._meshes, key, str(error))
        return self._meshes[key]

    def weights(self, scene: ScenePlayer) -> np.ndarray:
        """(C, N) ``importance.camera_weights`` of a scene, found once."""
        from ..engine.playback.importance import camera_weights

        if self._weights is None or self._weights[0] != scene.token:
            self._weights = scene.token, camera_weights(scene)
        return self._weights[1]

    def _keep(self, kept: OrderedDict, key: tuple, value: object) -> None:
        with self._lock:
            kept[key] = value
            while len(kept) > _VALUES_KEPT:
                kept.popitem(last=False)


def problems(scene: ScenePlayer) -> list[str]:
    """Sentences about edits that do not fit a scene."""
    return addon_state.get(EditedScenes).problems.get(scene.token, [])


def forget() -> None:
    """Drops all."""
    addon_state.reset(EditedScenes)
