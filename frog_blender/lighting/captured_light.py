"""Lights a scene's objects with what a capture shows at the current frame."""

from __future__ import annotations

import bpy
import numpy as np

from .. import point_cloud
from ..color_spaces import into_working_space, to_linear
from ..render.collect_instances import placed
from ..timeline import playback
from . import world

WIDTH = 1024
"""Pixels of an environment image, if nothing else is asked for."""


def light_by(
    obj: bpy.types.Object, context: bpy.types.Context, place: np.ndarray | None = None, width: int = WIDTH
) -> None:
    """Lights the objects of a context's scene by a capture.

    Args:
        place: (3,) where the light is taken, world units; None for the place nearest the middle of the capture that
            nothing stands close to.
        width: pixels of the environment image.

    Raises:
        FrogError: the capture cannot be shown.
    """
    from ..engine.playback.environment import environment, free_place

    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    shown = playback.scene_time(obj, context.scene.frame_current_final, evaluated)
    gaussians = placed(shown.gaussians(), np.array(evaluated.matrix_world, np.float64), obj.name)
    camera = world.AHEAD.copy()
    taken = free_place(gaussians, *point_cloud.middle_of(gaussians.means)) if place is None else place
    camera[:3, 3] = -camera[:3, :3] @ taken
    filmed = into_working_space(to_linear(np.array(shown.scene.header.background, np.float64)))
    world.light_with(world.lit_scene(context.scene), environment(gaussians, camera, width), filmed)
