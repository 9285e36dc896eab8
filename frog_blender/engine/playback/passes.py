"""The passes of an image as Blender has them: Combined, Depth and Vector.

Colours and depths are converted in bands of rows on all cores. Every step of numpy reads and writes tens of megabytes
of a large image, but a band stays in the caches: on two cores bands take a quarter of the time.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..gaussians import NumpyGaussians
from ..native.options import RasterizeOptions
from ..spherical_harmonics import SH_DC
from ..srgb import image_to_linear, to_linear
from .render import Drawing, draw

NO_SURFACE = 1e10
"""Blender's depth where nothing was hit."""
_BAND = 32  # rows
_LONGEST = 2048.0  # pixels; longer motions are clamped

Snapshot = tuple[NumpyGaussians | None, Camera]


def combined_pass(drawing: Drawing | None, background: Array | None, width: int, height: int) -> Array:
    """(H, W, 4) scene-linear premultiplied colour over a display-referred background (3,), None for transparent."""
    combined = _bottom_up(height, width, 4)
    if drawing is None:
        combined[..., :3] = 0.0 if background is None else to_linear(background)
        combined[..., 3] = background is not None
        return combined

    def transparent(rows: slice) -> None:
        alpha = np.clip(drawing.alpha[rows], 0.0, 1.0)[..., None]
        straight = drawing.rgb[rows] / np.maximum(alpha, 1e-6)
        np.clip(straight, 0.0, 1.0, out=straight)
        np.multiply(image_to_linear(straight), alpha, out=combined[rows, :, :3])
        combined[rows, :, 3:] = alpha

    def opaque(rows: slice) -> None:
        # Over in display space, which is how the scene was trained, so partly covered pixels look as they did there.
        assert background is not None
        brightest = max(1.0, float(background.max()))
        over = (1.0 - np.clip(drawing.alpha[rows], 0.0, 1.0)[..., None]) * background.astype(np.float32)
        over += drawing.rgb[rows]
        np.clip(over, 0.0, brightest, out=over)
        combined[rows, :, :3] = image_to_linear(over) if brightest == 1.0 else to_linear(over)
        combined[rows, :, 3] = 1.0

    _in_bands(height, transparent if background is None else opaque)
    return combined


def depth_pass(drawing: Drawing | None, width: int, height: int, added: float = 0.0) -> Array:
    """(H, W) planar distance of the median surface in world units, NO_SURFACE where there is none.

    ``added`` is how much further back the drawing's camera stood than Blender's.
    """
    depth = _bottom_up(height, width)
    if drawing is None:
        depth[...] = NO_SURFACE
        return depth

    def from_surface(rows: slice) -> None:
        depth[rows] = np.where(np.isfinite(drawing.median_z[rows]), drawing.median_z[rows] - added, NO_SURFACE)

    _in_bands(height, from_surface)
    return depth


def vector_pass(snapshot_at: Callable[[int], Snapshot], options: RasterizeOptions) -> Array:
    """The Vector pass (H, W, 4) of the options' region: motion of each pixel's surface, for Vector Blur; zero where
    nothing is.

    As Cycles has it: pixels to the right and upwards, first from this frame to the place before, then from the place
    later to this frame. Each Gaussian's motion on the screen is drawn in place of its colour, so a pixel gets the mean
    by blending weight.

    Args:
        snapshot_at: Gaussians and camera at an offset in frames from this one; called with -1, 1 and lastly 0.
    """
    before, after, (gaussians, camera) = (snapshot_at(offset) for offset in (-1, 1, 0))
    _, _, width, height = options.region_of(camera)
    result = np.zeros((height, width, 4), np.float32)
    if gaussians is None:
        return result
    here = _places(gaussians, camera)
    motions = {}
    for first, snapshot, sign in ((0, before, 1.0), (2, after, -1.0)):
        other, its_camera = snapshot
        if other is not None and len(other.means) == len(gaussians.means):
            motion = sign * (_places(other, its_camera) - here) * (1.0, -1.0)
            motion[other.opacities == 0] = np.nan  # an invisible Gaussian's position means nothing
            motions[first] = motion
    for first, motion in motions.items():
        # The other motion, if only one is known.
        known = np.where(np.isnan(motion), motions.get(2 - first, motion), motion)
        result[..., first : first + 2] = _drawn(gaussians, np.nan_to_num(known), camera, options)
    return result


def _places(gaussians: NumpyGaussians, camera: Camera) -> Array:
    """(N, 2) pixels; NaN behind the camera."""
    pixels, depths = camera.project(gaussians.means.astype(np.float64))
    return np.where(depths[:, None] > 1e-6, pixels, np.nan)


def _drawn(gaussians: NumpyGaussians, motions: Array, camera: Camera, options: RasterizeOptions) -> Array:
    """(H, W, 2) motion of each pixel, blended from motions (N, 2) of Gaussians."""
    longest = min(float(np.abs(motions).max(initial=0.0)), _LONGEST) or 1.0
    colors = np.full((len(motions), 1, 3), 0.5)  # drawn colours are not negative: a half stands for no motion
    colors[:, 0, :2] += 0.5 * (motions / longest).clip(-1, 1)
    drawing = draw(replace(gaussians, sh=((colors - 0.5) / SH_DC).astype(np.float32)), camera, options=options)
    covered = drawing.alpha[..., None]
    means = np.divide(drawing.rgb[..., :2], covered, out=np.full_like(drawing.rgb[..., :2], 0.5), where=covered > 1e-3)
    return (2 * means - 1) * longest


def _bottom_up(*shape: int) -> Array:
    """Float32 with rows from the top that lie in memory from the bottom: ``pass_pixels`` has nothing to copy."""
    return np.empty(shape, np.float32)[::-1]


def _in_bands(height: int, work: Callable[[slice], None]) -> None:
    bands = [slice(top, min(top + _BAND, height)) for top in range(0, height, _BAND)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # numpy releases the GIL
        list(pool.map(work, bands))
