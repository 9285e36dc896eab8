"""How many of its Gaussians a capture shows outside of FRoG's own images: the most important ones alone.

Which they are is found once for each scene (``engine.playback.importance``) and is the same at every frame, so nothing
flickers; what is left out is neither computed nor written.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakKeyDictionary

from .. import addon_state
from ..nodes import ellipsoid_nodes

if TYPE_CHECKING:
    import numpy as np

    from ..engine.playback.player import ScenePlayer

_KEPT = 4  # thinned scenes of a scene: objects and renders may each want another density
Fewer: TypeAlias = "tuple[ScenePlayer, np.ndarray]"
"""Some of a scene's Gaussians as a scene of their own, and (K,) which of those that move there are among them."""


class _Thinned:
    """What is known of one scene."""

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
    """What is known of all scenes.

    Attributes:
        lock: of ``known``.
        is_for_render: whether captures show what they are to show in another engine's render.
    """

    def __init__(self) -> None:
        self.known: WeakKeyDictionary[ScenePlayer, _Thinned] = WeakKeyDictionary()
        self.lock = threading.Lock()
        self.is_for_render = False


def thinned(obj: Any, scene: ScenePlayer) -> Fewer | None:
    """The most important Gaussians of ``scene``, if an object's points or ellipsoids show no more; None for all."""
    count = shown_count(obj, scene.count)
    if count >= scene.count:
        return None
    thinned_scenes = addon_state.get(ThinnedScenes)
    with thinned_scenes.lock:
        known = thinned_scenes.known.setdefault(scene, _Thinned())
    return known.take(scene, count)


def shown_count(obj: Any, total: int) -> int:
    """How many of ``total`` Gaussians an object shows now; never none, and no more ellipsoids than Blender bears."""
    settings = obj.frog
    share = settings.render_density if is_for_render() else settings.density
    count = max(1, round(total * share / 100))
    return min(count, ellipsoid_nodes.MOST) if settings.display == "ELLIPSOIDS" else count


def is_for_render() -> bool:
    """Whether captures show what they are to show in another engine's render."""
    return addon_state.get(ThinnedScenes).is_for_render


def set_for_render(is_shown: bool) -> None:
    """Whether captures are to show from now on what they show in another engine's render."""
    addon_state.get(ThinnedScenes).is_for_render = is_shown
