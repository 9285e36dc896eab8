"""The Vector pass: motion of each pixel's surface to the previous and the next frame, for Vector Blur.

As Cycles has it: pixels to the right and upwards, first from this frame to the place before, then from the place later
to this frame. Each Gaussian's way on the screen is drawn in place of its colour, so a pixel gets the mean by blending
weight.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import bpy

    from ..engine.capture.camera import Camera
    from ..engine.gaussians import GaussianArrays
    from ..engine.native.options import RasterizeOptions

_LONGEST = 2048.0  # pixels; longer motions are clamped

Snapshot = tuple["GaussianArrays | None", "Camera"]


def vectors(snapshot_at: Callable[[int], Snapshot], options: RasterizeOptions) -> np.ndarray:
    """(H, W, 4) of the options' region, rows from the top; zero where nothing is.

    Args:
        snapshot_at: Gaussians and camera at an offset in frames from this one; called with -1, 1 and lastly 0.
    """
    before, after, (gaussians, camera) = (snapshot_at(offset) for offset in (-1, 1, 0))
    _, _, width, height = options.region_of(camera)
    result = np.zeros((height, width, 4), np.float32)
    if gaussians is None:
        return result
    here = _places(gaussians, camera)
    ways = {}
    for first, snapshot, sign in ((0, before, 1.0), (2, after, -1.0)):
        other, its_camera = snapshot
        if other is not None and len(other.means) == len(gaussians.means):
            way = sign * (_places(other, its_camera) - here) * (1.0, -1.0)
            way[other.opacities == 0] = np.nan  # an invisible Gaussian's position means nothing
            ways[first] = way
    for first, way in ways.items():
        known = np.where(np.isnan(way), ways.get(2 - first, way), way)  # the other motion, if only one is known
        result[..., first : first + 2] = _drawn(gaussians, np.nan_to_num(known), camera, options)
    return result


def _places(gaussians: GaussianArrays, camera: Camera) -> np.ndarray:
    """(N, 2) pixels; NaN behind the camera."""
    pixels, depths = camera.project(gaussians.means.astype(np.float64))
    return np.where(depths[:, None] > 1e-6, pixels, np.nan)


def _drawn(gaussians: GaussianArrays, way: np.ndarray, camera: Camera, options: RasterizeOptions) -> np.ndarray:
    """(H, W, 2) motion of each pixel, blended from motions (N, 2) of Gaussians."""
    from dataclasses import replace

    from ..engine.playback.render import draw
    from ..engine.spherical_harmonics import SH_DC

    longest = min(float(np.abs(way).max(initial=0.0)), _LONGEST) or 1.0
    colors = np.full((len(way), 1, 3), 0.5)  # drawn colours are not negative: a half stands for no motion
    colors[:, 0, :2] += 0.5 * (way / longest).clip(-1, 1)
    drawing = draw(replace(gaussians, sh=((colors - 0.5) / SH_DC).astype(np.float32)), camera, options=options)
    covered = drawing.alpha[..., None]
    means = np.divide(drawing.rgb[..., :2], covered, out=np.full_like(drawing.rgb[..., :2], 0.5), where=covered > 1e-3)
    return (2 * means - 1) * longest


def register_pass(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
    if layer.use_pass_vector:
        engine.register_pass(scene, layer, "Vector", 4, "XYZW", "VECTOR")
