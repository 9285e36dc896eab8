"""A training's scene in the viewports while it runs: as splats, or as points where no graphics card draws splats."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from .. import addon_state, reported_once
from ..engine.spherical_harmonics import SH_DC
from ..scene_import.capture_objects import of_same_capture
from ..tasks.training import TrainingTask, watch_live
from ..timeline.playback_cache import SceneTime
from . import drawing
from .picture import Shown

if TYPE_CHECKING:
    from ..engine.playback.player import ScenePlayer

START_FRAME = 1.0
"""Of the timeline, at which a capture's first image is shown, as when it is imported."""
_MOST_POINTS = 20_000
_FAINT = 0.1  # opacity: fainter ones are fog as points
_POINT_SIZE = 3.0  # pixels


class LivePoints:
    """The points of the last snapshot.

    Attributes:
        handler: of Blender.
        key: what the batch shows.
        batch: of the graphics card.
    """

    def __init__(self) -> None:
        self.handler: Any = None
        self.key: Any = None
        self.batch: Any = None


def shown_in(scene: bpy.types.Scene) -> Shown | None:
    """The running training's scene at the current frame; None where the scene plays a result of that capture."""
    task = TrainingTask.current()
    player = task.live.shown_in(scene) if task is not None and task.live is not None else None
    if player is None or of_same_capture(scene, player.header.capture_path):
        return None
    time = player.time_of(scene.frame_current_final - START_FRAME)
    return Shown("training", SceneTime(player, time), np.eye(4))


def points(scene: ScenePlayer, shown: SceneTime) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) places and (N, 4) display-referred colours of at most _MOST_POINTS of a scene's Gaussians."""
    part = shown.part()
    means, base = scene.column("means", part), scene.column("base", part)
    chosen = np.flatnonzero(base[:, 3] >= _FAINT)
    chosen = chosen[:: max(1, -(-len(chosen) // _MOST_POINTS))]
    colors = np.ones((len(chosen), 4), np.float32)
    colors[:, :3] = np.clip(0.5 + SH_DC * base[chosen, :3], 0.0, 1.0)
    return means[chosen], colors


def _draw() -> None:
    """Blender's handler."""
    try:
        scene = bpy.context.scene
        if not drawing.shows_sources(scene) and (shown := shown_in(scene)) is not None:
            _draw_points(shown)
    except Exception as error:
        reported_once.unexpected("drawing the training", error)


def _draw_points(shown: Shown) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    drawn, key = addon_state.get(LivePoints), shown.time.key
    shader = gpu.shader.from_builtin("POINT_FLAT_COLOR")
    if drawn.key != key:
        places, colors = points(shown.time.scene, shown.time)
        drawn.batch = batch_for_shader(shader, "POINTS", {"pos": places, "color": colors})
        drawn.key = key
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)  # near points hide far ones
    gpu.state.point_size_set(_POINT_SIZE * bpy.context.preferences.system.pixel_size)
    drawn.batch.draw(shader)
    gpu.state.point_size_set(1.0)
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def register() -> None:
    if bpy.app.background:  # nothing is drawn, and there may be no graphics
        return
    drawing.add_source(shown_in)
    watch_live(drawing.changed)
    handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    addon_state.get(LivePoints).handler = handler


def unregister() -> None:
    drawn = addon_state.get(LivePoints)
    if drawn.handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(drawn.handler, "WINDOW")
        drawn.handler = None
    drawn.batch = None
