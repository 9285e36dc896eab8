"""Level of detail: the most important Gaussians only, everywhere but in FRoG's own images.

Which they are is found once for each scene (``engine.playback.importance``) and is the same at every frame, so nothing
flickers; what is left out is neither computed nor written.
"""

from typing import TypeAlias

import bpy
import numpy as np

from .. import addon_state
from ..engine.playback.importance import most_important, ranking
from ..engine.playback.player import ScenePlayer
from ..nodes import ellipsoid_nodes
from .edited_scenes import EditedScenes
from .render_thread import rendering

Fewer: TypeAlias = tuple[ScenePlayer, np.ndarray]
"""A scene of some of the Gaussians, and (K,) the indices of its dynamic Gaussians in the whole scene."""


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

    made = addon_state.get(EditedScenes).made
    order = made(scene, "order", None, lambda _: ranking(scene))
    return made(scene, "thinned", count, lambda _: _most_important(scene, order, count))


def _most_important(scene: ScenePlayer, order: np.ndarray, count: int) -> Fewer:
    chosen = most_important(order, count)
    return scene.subset(chosen), chosen[chosen < scene.num_dynamic]
