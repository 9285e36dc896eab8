"""What is made of scenes, once for each scene and purpose: edited ones, and thinned ones. Any thread may ask."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import Any, TypeAlias, TypeVar

from ..engine.editing.closed_mesh import ClosedMesh
from ..engine.editing.edited_scene import EditedScene, edited
from ..engine.editing.edits import Edits
from ..engine.editing.marks import Marks
from ..engine.playback.player import ScenePlayer

_KEPT, _VALUES_KEPT = 4, 16
_SCENES_KEPT = {"edited": 16, "order": 1000, "thinned": 1000, "weights": 1, "sizes": 1}
"""By purpose: of edited ones some are of thinned ones, which nobody forgets."""
T = TypeVar("T")
Edited: TypeAlias = tuple[ScenePlayer, list[str]]
"""A scene with edits, and sentences about those that do not fit it."""


class EditedScenes:
    """What was made of the scenes and edits that were asked for last.

    Attributes:
        cropped: the ``session_uid`` of each capture that had crops when its edits were asked for last.
        marks: of a number of Gaussians, a scene and a text; None for damaged ones.
        mesh: the closed mesh of vertices and triangles; ValueError for one that is none.
    """

    def __init__(self) -> None:
        self.cropped: set[int] = set()
        self.marks, self.mesh = lru_cache(_VALUES_KEPT)(_marks), lru_cache(_VALUES_KEPT)(ClosedMesh)
        # By purpose, and by the scenes' tokens.
        self._made: dict[str, OrderedDict[str, OrderedDict[Any, Any]]] = {name: OrderedDict() for name in _SCENES_KEPT}
        self._lock = threading.Lock()

    def of(self, scene: ScenePlayer, edits: Edits) -> Edited:
        """A scene with edits; as it is, if they change nothing of it."""

        def make(earlier: list[Edited]) -> Edited:
            before = next((made for made, _ in earlier if isinstance(made, EditedScene)), None)
            return edited(scene, edits, before)

        return self.made(scene, "edited", edits, make)

    def made(self, scene: ScenePlayer, purpose: str, key: object, make: Callable[[list[Any]], T]) -> T:
        """What is made of a scene for a purpose, of the few keys that were asked for last.

        Args:
            make: makes it; given what was made for other keys, the latest first.
        """
        with self._lock:
            kept = self._made[purpose].setdefault(scene.token, OrderedDict())
            known, earlier = kept.get(key), list(reversed(kept.values()))
        if known is None:
            known = make(earlier)
        self._keep(kept, key, known, _KEPT)
        self._keep(self._made[purpose], scene.token, kept, _SCENES_KEPT[purpose])
        return known

    def forget(self, scene: ScenePlayer) -> None:
        """Drops what was made of a scene that is not played any more."""
        with self._lock:
            for of_scenes in self._made.values():
                of_scenes.pop(scene.token, None)

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
