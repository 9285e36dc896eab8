"""Level of detail: the most important Gaussians only, everywhere but in FRoG's own images.

Which they are is found once for each scene (``engine.playback.importance``) and is the same at every frame, so nothing
flickers; what is left out is neither computed nor written.
"""

import bpy

from .. import addon_state
from ..engine.playback.importance import most_important, ranking
from ..engine.playback.player import ScenePlayer
from .edited_scenes import EditedScenes
from .render_thread import rendering


def thinned(obj: bpy.types.Object, scene: ScenePlayer) -> ScenePlayer | None:
    """The most important Gaussians of ``scene`` if the object shows fewer than all, at least one; None for all."""
    settings = obj.frog
    share = settings.render_density if rendering().has_render_density else settings.density
    count = max(1, round(scene.count * share / 100))
    if count >= scene.count:
        return None

    made = addon_state.get(EditedScenes).made
    order = made(scene, "order", None, lambda _: ranking(scene))
    return made(scene, "thinned", count, lambda _: scene.subset(most_important(order, count)))
