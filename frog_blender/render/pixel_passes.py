"""Converts the rasterizer's output to pixels of passes, in bands of rows on all cores.

Every step of numpy reads and writes tens of megabytes of a large image, but a band stays in the caches: on two cores
bands take a quarter of the time.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from ..color_spaces import image_to_linear, to_linear

if TYPE_CHECKING:
    from ..engine.playback.render import Drawing

NO_SURFACE = 1e10  # Blender's depth where nothing was hit
_BAND = 32  # rows
_STRIPE = 8  # pixels


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
    threads = min(os.cpu_count() or 1, len(bands))
    if threads < 2:
        for band in bands:
            work(band)
        return
    with ThreadPoolExecutor(threads) as pool:  # numpy releases the GIL
        list(pool.map(work, bands))
