"""Two views of known cameras: the line of the second image on which each point of the first must lie, and how far off.

The one place that knows this: seeds, checks, calibration and synchronisation ask it.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Float64s
from .camera import Camera


def fundamental(first: Camera, second: Camera) -> Float64s:
    """(3, 3) of norm 1: ``b @ F @ a`` is 0 for pixels a of the first and b of the second that show the same point."""
    relative = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    x, y, z = relative[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Float64s = np.linalg.inv(second.intrinsics).T @ cross @ relative[:3, :3] @ np.linalg.inv(first.intrinsics)
    return matrix / max(float(np.linalg.norm(matrix)), 1e-300)


def line_distances(matrix: Float64s, first: Float64s, second: Float64s) -> tuple[Float64s, Float64s]:
    """Signed distances (N,) in pixels of ``second`` (N, 2) from the lines of ``first``, and the other way round."""
    a, b = _homogeneous(first), _homogeneous(second)
    lines_b, lines_a = a @ matrix.T, b @ matrix
    residual = (lines_b * b).sum(axis=1)
    lengths = [np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-300) for lines in (lines_b, lines_a)]
    return residual / lengths[0], residual / lengths[1]


def sampson_distances(matrix: Float64s, first: Float64s, second: Float64s) -> Float64s:
    """(N,) signed pixels by which positions (N, 2) must move together to fulfil the constraint (Sampson)."""
    a, b = _homogeneous(first), _homogeneous(second)
    lines_b, lines_a = a @ matrix.T, b @ matrix
    squares = (lines_b[:, :2] ** 2).sum(axis=1) + (lines_a[:, :2] ** 2).sum(axis=1)
    distances: Float64s = (b * lines_b).sum(axis=1) / np.sqrt(np.maximum(squares, 1e-300))
    return distances


def sampson_table(matrix: Float64s, first: Float64s, second: Float64s) -> Float64s:
    """(N, K) the same of every position (N, 2) with every position (K, 2)."""
    a, b = _homogeneous(first), _homogeneous(second)
    lines_b, lines_a = a @ matrix.T, b @ matrix
    squares = (lines_b[:, :2] ** 2).sum(axis=1)[:, None] + (lines_a[:, :2] ** 2).sum(axis=1)[None]
    distances: Float64s = (lines_b @ b.T) / np.sqrt(np.maximum(squares, 1e-300))
    return distances


def _homogeneous(pixels: Float64s) -> Float64s:
    return np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
