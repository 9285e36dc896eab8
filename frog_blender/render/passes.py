"""What Blender takes of passes, and Object Index, which is of captures; the engine makes the others."""

import bpy
import numpy as np

INDEX = "Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB"

_STRIPE = 8  # pixels


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
