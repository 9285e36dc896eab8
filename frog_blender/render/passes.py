"""The passes of an image, as Blender takes them: Combined, Depth, Vector and Object Index.

Colours and depths are converted in bands of rows on all cores. Every step of numpy reads and writes tens of megabytes
of a large image, but a band stays in the caches: on two cores bands take a quarter of the time.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import bpy
import numpy as np

from ..color_spaces import image_to_linear, to_linear
from ..engine.capture.camera import Camera
from ..engine.gaussians import GaussianArrays
from ..engine.native.options import RasterizeOptions
from ..engine.playback.render import Drawing, draw
from ..engine.spherical_harmonics import SH_DC

INDEX = "Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB"

NO_SURFACE = 1e10  # Blender's depth where nothing was hit
_BAND = 32  # rows
_STRIPE = 8  # pixels
_LONGEST = 2048.0  # pixels; longer motions are clamped

Snapshot = tuple["GaussianArrays | None", "Camera"]


def combined_pass(drawing: Drawing | None, background: np.ndarray | None, width: int, height: int) -> np.ndarray:
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


def depth_pass(drawing: Drawing | None, width: int, height: int, added: float = 0.0) -> np.ndarray:
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


def index_pass(median_index: np.ndarray | None, captures: list[tuple[int, int]], width: int, height: int) -> np.ndarray:
    """The Object Index pass (H, W) float32: the Pass Index of the capture at each pixel's surface, which is that of
    Depth; zero where nothing is.

    Args:
        median_index: (H, W) the Gaussian at each pixel's surface, below zero where there is none; None without any.
        captures: how many Gaussians each capture has, in the order in which they were drawn, and its pass index.
    """
    if median_index is None:
        return np.zeros((height, width), np.float32)
    counts, numbers = np.array(captures).T
    owners = np.append(np.repeat(numbers, counts), 0).astype(np.float32)  # the last one is what -1 picks
    return owners[np.maximum(median_index, -1)]


def vector_pass(snapshot_at: Callable[[int], Snapshot], options: RasterizeOptions) -> np.ndarray:
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


def _places(gaussians: GaussianArrays, camera: Camera) -> np.ndarray:
    """(N, 2) pixels; NaN behind the camera."""
    pixels, depths = camera.project(gaussians.means.astype(np.float64))
    return np.where(depths[:, None] > 1e-6, pixels, np.nan)


def _drawn(gaussians: GaussianArrays, motions: np.ndarray, camera: Camera, options: RasterizeOptions) -> np.ndarray:
    """(H, W, 2) motion of each pixel, blended from motions (N, 2) of Gaussians."""
    longest = min(float(np.abs(motions).max(initial=0.0)), _LONGEST) or 1.0
    colors = np.full((len(motions), 1, 3), 0.5)  # drawn colours are not negative: a half stands for no motion
    colors[:, 0, :2] += 0.5 * (motions / longest).clip(-1, 1)
    drawing = draw(replace(gaussians, sh=((colors - 0.5) / SH_DC).astype(np.float32)), camera, options=options)
    covered = drawing.alpha[..., None]
    means = np.divide(drawing.rgb[..., :2], covered, out=np.full_like(drawing.rgb[..., :2], 0.5), where=covered > 1e-3)
    return (2 * means - 1) * longest


def refusal_pattern(width: int, height: int) -> np.ndarray:
    """(H, W, 4) opaque stripes of magenta and black, in place of an image that could not be drawn."""
    rows, columns = np.indices((height, width))
    pattern = np.zeros((height, width, 4), np.float32)
    pattern[(rows + columns) // _STRIPE % 2 == 0] = (1.0, 0.0, 1.0, 0.0)
    pattern[..., 3] = 1.0
    return pattern


def pass_pixels(values: np.ndarray) -> np.ndarray:
    """A pass (H, W, ...) with rows from the top as Blender takes it: from the bottom, and the only form that it copies
    at once, 1-D float32."""
    return np.ascontiguousarray(values[::-1], dtype=np.float32).ravel()


def _bottom_up(*shape: int) -> np.ndarray:
    """Float32 with rows from the top that lie in memory from the bottom: ``pass_pixels`` has nothing to copy."""
    return np.empty(shape, np.float32)[::-1]


def _in_bands(height: int, work: Callable[[slice], None]) -> None:
    bands = [slice(top, min(top + _BAND, height)) for top in range(0, height, _BAND)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # numpy releases the GIL
        list(pool.map(work, bands))
