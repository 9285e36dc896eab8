"""Level of detail: the most important Gaussians only, everywhere but in FRoG's own images.

Which they are is found once for each scene (``engine.playback.importance``) and is the same at every frame, so nothing
flickers; what is left out is neither computed nor written.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, TypeAlias
from weakref import WeakKeyDictionary

from .. import addon_state
from ..nodes import ellipsoid_nodes

if TYPE_CHECKING:
    import bpy
    import numpy as np

    from ..engine.playback.player import ScenePlayer

_KEPT = 4  # thinned scenes of a scene: objects and renders may each want another density
Fewer: TypeAlias = "tuple[ScenePlayer, np.ndarray]"
"""A scene of some of the Gaussians, and (K,) the indices of its dynamic Gaussians in the whole scene."""


class _Thinned:
    """Thinned versions of one scene."""

    def __init__(self) -> None:
        self.lock = threading.Lock()  # a render evaluates frames in its own thread
        self.order: np.ndarray | None = None
        self.scenes: OrderedDict[int, Fewer] = OrderedDict()

    def take(self, scene: ScenePlayer, count: int) -> Fewer:
        from ..engine.playback.importance import most_important, ranking

        with self.lock:
            if count not in self.scenes:
                if self.order is None:
                    self.order = ranking(scene)
                kept = most_important(self.order, count)
                self.scenes[count] = scene.subset(kept), kept[kept < scene.num_dynamic]
            self.scenes.move_to_end(count)
            while len(self.scenes) > _KEPT:
                self.scenes.popitem(last=False)
            return self.scenes[count]


class ThinnedScenes:
    """Thinned versions of all scenes.

    Attributes:
        lock: of ``known``.
        is_for_render: whether captures show what they are to show in another engine's render.
    """

    def __init__(self) -> None:
        self.known: WeakKeyDictionary[ScenePlayer, _Thinned] = WeakKeyDictionary()
        self.lock = threading.Lock()
        self.is_for_render = False


def thinned(obj: bpy.types.Object, scene: ScenePlayer) -> Fewer | None:
    """The most important Gaussians of ``scene`` if the object shows fewer than all; None for all."""
    count = shown_count(obj, scene.count)
    if count >= scene.count:
        return None
    thinned_scenes = addon_state.get(ThinnedScenes)
    with thinned_scenes.lock:
        known = thinned_scenes.known.setdefault(scene, _Thinned())
    return known.take(scene, count)


def shown_count(obj: bpy.types.Object, total: int) -> int:
    """Number of ``total`` Gaussians that an object shows now: at least one, and at most as many ellipsoids as
    Blender can handle.
    """
    settings = obj.frog
    share = settings.render_density if is_for_render() else settings.density
    count = max(1, round(total * share / 100))
    return min(count, ellipsoid_nodes.MOST) if settings.display == "ELLIPSOIDS" else count


def is_for_render() -> bool:
    """Whether captures currently use their render density."""
    return addon_state.get(ThinnedScenes).is_for_render


def set_for_render(is_shown: bool) -> None:
    """Sets whether captures use their render density."""
    addon_state.get(ThinnedScenes).is_for_render = is_shown
