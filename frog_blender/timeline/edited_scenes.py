"""Edited scenes, made once for each state of their edits. Any thread may ask."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from .. import addon_state
from ..engine.editing.closed_mesh import ClosedMesh
from ..engine.editing.edited_scene import EditedScene, edited
from ..engine.editing.edits import Edits
from ..engine.editing.marks import Marks
from ..engine.playback.importance import camera_weights
from ..engine.playback.player import ScenePlayer

_EDITS_KEPT, _SCENES_KEPT, _VALUES_KEPT = 4, 16, 16
Edited: TypeAlias = "tuple[ScenePlayer, list[str]]"
"""A scene with edits, and sentences about those that do not fit it."""


class EditedScenes:
    """What was made of the edits that were asked for last.

    Attributes:
        cropped: the ``session_uid`` of each capture that had crops when its edits were asked for last.
        are_changing: whether several edits are being changed by who refreshes afterwards, once instead of at each.
        marks: of a number of Gaussians, a scene and a text; None for damaged ones.
        mesh: the closed mesh of vertices and triangles; a phrase about one that is none.
    """

    def __init__(self) -> None:
        self.cropped: set[int] = set()
        self.are_changing = False
        self.marks, self.mesh = lru_cache(_VALUES_KEPT)(_marks), lru_cache(_VALUES_KEPT)(_mesh)
        self._scenes: OrderedDict[str, OrderedDict[Edits, Edited]] = OrderedDict()  # by tokens of what is edited
        self._weights: tuple[str, np.ndarray] | None = None
        self._lock = threading.Lock()

    def of(self, scene: ScenePlayer, edits: Edits) -> Edited:
        """A scene with edits; as it is, if they change nothing of it."""
        with self._lock:
            kept = self._scenes.setdefault(scene.token, OrderedDict())
            known = kept.get(edits)
            before = next((edited for edited, _ in reversed(kept.values()) if isinstance(edited, EditedScene)), None)
        if known is None:
            known = edited(scene, edits, before)
        self._keep(kept, edits, known, _EDITS_KEPT)
        self._keep(self._scenes, scene.token, kept, _SCENES_KEPT)
        return known

    def forget(self, scene: ScenePlayer) -> None:
        """Drops what was made of a scene that is not played any more."""
        with self._lock:
            self._scenes.pop(scene.token, None)

    def weights(self, scene: ScenePlayer) -> np.ndarray:
        """(C, N) ``importance.camera_weights`` of a scene, found once."""
        if self._weights is None or self._weights[0] != scene.token:
            self._weights = scene.token, camera_weights(scene)
        return self._weights[1]

    def _keep(self, kept: OrderedDict, key: object, value: object, most: int) -> None:
        with self._lock:
            kept[key] = value
            kept.move_to_end(key)
            while len(kept) > most:
                kept.popitem(last=False)


def _marks(count: int, scene: str, text: str) -> Marks | None:
    with suppress(ValueError):
        return Marks.from_text(count, scene, text)
    return None


def _mesh(vertices: bytes, triangles: bytes) -> ClosedMesh | str:
    try:
        return ClosedMesh(vertices, triangles)
    except ValueError as error:
        return str(error)


@contextmanager
def changing_several() -> Iterator[None]:
    """Around changes of edits. The caller refreshes afterwards."""
    scenes = addon_state.get(EditedScenes)
    before, scenes.are_changing = scenes.are_changing, True
    try:
        yield
    finally:
        scenes.are_changing = before
