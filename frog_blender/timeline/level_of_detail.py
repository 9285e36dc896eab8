"""Level of detail: the most important Gaussians only, everywhere but in FRoG's own images.

Which they are is found once for each scene (``engine.playback.importance``) and is the same at every frame, so nothing
flickers; what is left out is neither computed nor written.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TypeAlias
from weakref import WeakKeyDictionary

import bpy
import numpy as np

from .. import addon_state
from ..engine.playback.importance import most_important, ranking
from ..engine.playback.player import ScenePlayer
from ..nodes import ellipsoid_nodes
from .render_thread import rendering

_KEPT = 4  # thinned scenes of a scene: objects and renders may each want another density
Fewer: TypeAlias = "tuple[ScenePlayer, np.ndarray]"
"""A scene of some of the Gaussians, and (K,) the indices of its dynamic Gaussians in the whole scene."""


class ThinnedScenes:
    """Thinned versions of all scenes.

    Attributes:
        kept: of each scene its Gaussians, the most important first, and the versions that were asked for last, by
            their number of Gaussians.
        lock: of it, because a render evaluates frames in its own thread.
    """

    def __init__(self) -> None:
        self.kept: WeakKeyDictionary[ScenePlayer, tuple[np.ndarray, OrderedDict[int, Fewer]]] = WeakKeyDictionary()
        self.lock = threading.Lock()


def thinned(obj: bpy.types.Object, scene: ScenePlayer) -> Fewer | None:
    """The most important Gaussians of ``scene`` if the object shows fewer than all; None for all. At least one, and at
    most as many ellipsoids as Blender can handle.
    """
    settings = obj.frog
    share = settings.render_density if rendering().has_render_density else settings.density
    count = max(1, round(scene.count * share / 100))
    if settings.display == "ELLIPSOIDS":
        count = min(count, ellipsoid_nodes.MOST)
    if count >= scene.count:
        return None

    all_thinned = addon_state.get(ThinnedScenes)
    with all_thinned.lock:
        if scene not in all_thinned.kept:
            all_thinned.kept[scene] = ranking(scene), OrderedDict()
        order, scenes = all_thinned.kept[scene]
        fewer = scenes.pop(count, None)
        if fewer is None:
            chosen = most_important(order, count)
            fewer = scene.subset(chosen), chosen[chosen < scene.num_dynamic]
        scenes[count] = fewer
        if len(scenes) > _KEPT:
            scenes.popitem(last=False)
        return fewer
