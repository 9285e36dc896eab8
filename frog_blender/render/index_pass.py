"""The Object Index pass: the Pass Index of the capture at each pixel's surface, for ID masks.

The surface is that of Depth: the Gaussian that takes the light coming through to one half. It costs a look-up, since
every drawing names that Gaussian.
"""

from __future__ import annotations

import bpy
import numpy as np

NAME = "Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB"


def indices(median_index: np.ndarray | None, captures: list[tuple[int, int]], width: int, height: int) -> np.ndarray:
    """(H, W) float32, zero where nothing is.

    Args:
        median_index: (H, W) the Gaussian at each pixel's surface, below zero where there is none; None without any.
        captures: how many Gaussians each capture has, in the order in which they were drawn, and its pass index.
    """
    if median_index is None:
        return np.zeros((height, width), np.float32)
    counts, numbers = np.array(captures).T
    owners = np.append(np.repeat(numbers, counts), 0).astype(np.float32)  # the last one is what -1 picks
    return owners[np.maximum(median_index, -1)]


def register_pass(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
    if layer.use_pass_object_index:
        engine.register_pass(scene, layer, NAME, 1, "X", "VALUE")
