"""The cameras of the chosen capture, drawn into viewports before there is a scene of it, and while one is trained, and
what is said of a training in viewports; the file does not change.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader

from .. import addon_state
from ..engine.capture.camera import Camera
from ..engine.capture.capture import Capture
from ..tasks.training import TrainingTask
from ..timeline import playback
from ..viewport import live, views
from . import capture_summary
from .overlay import Overlay, distance_to, draw_text

DEPTH = 0.1  # of a drawn camera, in diameters of the rig
_MOST_NAMES = 40
_MOST_POINTS = 50_000
_REACH = 8.0  # pixels from a line that a click on it may be
_BELOW_TEXT = 130  # pixels under the upper edge, where Blender's own text ends
_COLOR, _HELD_OUT, _POINTS = (1.0, 0.62, 0.15, 1.0), (0.35, 0.7, 1.0, 1.0), (0.6, 0.6, 0.6, 0.6)
EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1), (1, 5), (5, 2))
"""Between corners of a camera: a pyramid from the centre to its image, with a roof that shows what is up."""


class RigOverlay(Overlay):
    """What draws rigs into viewports."""


def shown_capture(scene: bpy.types.Scene) -> Capture | None:
    """The capture whose rig is drawn in a scene: the one in the panel, until a scene of captures is imported, and
    while one is trained.
    """
    settings = scene.frog
    if not settings.show_rig or (any(playback.captures(scene.objects)) and live.seen_in(scene) is None):
        return None
    return capture_summary.of(settings).capture


def corners_of(cameras: Sequence[Camera]) -> np.ndarray:
    """(N, 6, 3) of N cameras in the world: the centre, the image's corners and a point above it."""
    centres = np.array([camera.center for camera in cameras]).reshape(-1, 3)
    depth = DEPTH * (float(np.ptp(centres, axis=0).max(initial=0.0)) or 1.0)
    return np.array([_corners(camera, depth) for camera in cameras]).reshape(-1, 6, 3)


def _corners(camera: Camera, depth: float) -> np.ndarray:
    """(6, 3) of one camera, whose image is drawn at a depth."""
    width, height = camera.width, camera.height
    pixels = np.array([(0, 0), (width, 0), (width, height), (0, height), (width / 2, -0.25 * height)])
    rays = np.concatenate([pixels, np.ones((5, 1))], axis=1) @ np.linalg.inv(camera.intrinsics).T * depth
    return np.concatenate([np.zeros((1, 3)), rays]) @ camera.rotation + camera.center


def camera_at(context: bpy.types.Context, pixel: tuple[int, int]) -> str:
    """The name of the drawn camera of whose lines one lies at a pixel of the context's region, from its lower left
    corner; "" for none.
    """
    capture = shown_capture(context.scene)
    if capture is None:
        return ""
    corners = np.concatenate([at := corners_of(capture.cameras), np.ones_like(at[..., :1])], axis=-1)
    seen = corners @ np.array(context.region_data.perspective_matrix).T
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = (seen[..., :2] / seen[..., 3:] + 1) / 2 * (context.region.width, context.region.height)
        distance = distance_to(flat[:, np.array(EDGES)], np.array(pixel))
    distance[(seen[..., 3] <= 0)[:, np.array(EDGES)].any(-1)] = np.inf  # behind the eye, or in it
    nearest = np.nan_to_num(distance, nan=np.inf).min(1)
    return capture.cameras[int(nearest.argmin())].name if nearest.min(initial=np.inf) <= _REACH else ""


@lru_cache(maxsize=4)  # windows may show several scenes at a time
def _batches_of(capture: Capture) -> list[tuple[Any, tuple[float, ...]]]:
    """What is drawn of a capture, on the graphics card, with a colour each."""
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    cameras = list(capture.cameras)
    lines = corners_of(cameras)[:, np.array(EDGES)].astype(np.float32)
    held_out = np.array([camera.name in capture.test_cameras for camera in cameras], dtype=bool)
    batches: list[tuple[Any, tuple[float, ...]]] = []
    for chosen, color in ((~held_out, _COLOR), (held_out, _HELD_OUT)):
        if chosen.any():
            batch = batch_for_shader(shader, "LINES", {"pos": lines[chosen].reshape(-1, 3)})
            batches.append((batch, color))
    if capture.points is not None and len(capture.points):
        step = -(-len(capture.points) // _MOST_POINTS)
        points = capture.points[::step].astype(np.float32)
        batches.append((batch_for_shader(shader, "POINTS", {"pos": points}), _POINTS))
    return batches


def _draw_lines() -> None:
    capture = shown_capture(bpy.context.scene)
    if capture is None:
        return
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    is_covered = live.shown_in(bpy.context.scene) is not None  # and the depth is that of what lies under it
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE" if is_covered else "LESS_EQUAL")
    shader.bind()
    for batch, color in _batches_of(capture):
        if is_covered and color == _POINTS:
            continue
        shader.uniform_float("color", color)
        batch.draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _draw_names() -> None:
    context = bpy.context
    capture = shown_capture(context.scene)
    if capture is None or len(capture.cameras) > _MOST_NAMES:
        return
    for camera in capture.cameras:
        pixel = location_3d_to_region_2d(context.region, context.region_data, camera.center)
        if pixel is not None:
            draw_text(camera.name, pixel.x + 6, pixel.y + 6, 11 * context.preferences.system.ui_scale, _COLOR)


def told(scene: bpy.types.Scene, space: bpy.types.SpaceView3D) -> list[str]:
    """What a viewport says of a running training, in lines; empty for nothing."""
    seen, task = live.seen_in(scene), TrainingTask.current()
    if seen is None or task is None:
        elsewhere = live.elsewhere(scene)
        return [f"{elsewhere} Show It Here in the FRoG tab shows it here."] if elsewhere else []
    state, camera = task.state, seen.camera(scene.frog.preview_camera)
    doing = f"step {state.step:,} of {state.steps:,}" if seen.player is not None else task.standing.stage.lower()
    lines = [f"Training: {doing}"]
    if camera is not None:
        is_through = views.is_through(space)
        key = "back to your view" if is_through else f"through camera {camera.name}"
        click = "" if shown_capture(scene) is None else "    Click a camera: preview through it"
        lines.append(f"Numpad 0: {key}{click}")
    if any(playback.captures(scene.objects)):
        lines.append("Other captures are hidden meanwhile: Show in Viewports in the FRoG tab.")
    return lines


def _draw_told() -> None:
    context = bpy.context
    scale = context.preferences.system.ui_scale
    for index, line in enumerate(told(context.scene, context.space_data)):
        height = context.region.height - (_BELOW_TEXT + 18 * index) * scale
        draw_text(line, 70 * scale, height, 13 * scale, (0.95, 0.95, 0.95, 1.0))


def register() -> None:
    if bpy.app.background:  # nothing is drawn, and there may be no graphics
        return
    overlay = addon_state.get(RigOverlay)
    overlay.draw_by(bpy.types.SpaceView3D, "the rig", _draw_lines, "POST_VIEW")
    overlay.draw_by(bpy.types.SpaceView3D, "the cameras' names", _draw_names)
    overlay.draw_by(bpy.types.SpaceView3D, "what a training says", _draw_told)


def unregister() -> None:
    addon_state.get(RigOverlay).end()
    _batches_of.cache_clear()
