"""Two views: which views to compare, which of their features match, and how far these lie off their epipolar lines.

The one place that knows this: seeds, checks, calibration and synchronization ask it.
"""

from collections.abc import Sequence

import numpy as np

from ..arrays import Float32s, Float64s, Ints
from .camera import Camera


def alike_pairs(cameras: Sequence[Camera], partners: int) -> list[tuple[int, int]]:
    """Indices of each camera and of so many others that look in directions nearest to its own."""
    forward = np.array([camera.forward for camera in cameras])
    alike = forward @ forward.T
    np.fill_diagonal(alike, -np.inf)
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, : min(partners, len(cameras) - 1)].tolist()
    return sorted({(min(i, j), max(i, j)) for i, row in enumerate(nearest) for j in row})


def mutual(similarity: Float32s, ratio: float, farthest: float = np.inf) -> tuple[Ints, Ints]:
    """Rows and columns of the mutual best of unit descriptors' products (N, K) that are clearly better than the second
    best in their row, by Lowe's ratio test (2004).

    Args:
        similarity: is changed.
        ratio: of their distances, at most.
        farthest: distance of the best.
    """
    best, columns = similarity.argmax(axis=1), similarity.argmax(axis=0)
    rows = np.arange(len(best))
    score = similarity[rows, best]
    similarity[rows, best] = -2.0
    distance, second = (np.sqrt(np.maximum(2 - 2 * values, 0)) for values in (score, similarity.max(axis=1)))
    keep = (distance < ratio * second) & (distance < farthest) & (columns[best] == rows)
    return rows[keep].astype(np.int64), best[keep].astype(np.int64)


def fundamental(first: Camera, second: Camera) -> Float64s:
    """(3, 3) of norm 1: ``b @ F @ a`` is 0 for pixels a of the first and b of the second that show the same point."""
    relative = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    x, y, z = relative[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Float64s = np.linalg.inv(second.intrinsics).T @ cross @ relative[:3, :3] @ np.linalg.inv(first.intrinsics)
    return matrix / max(float(np.linalg.norm(matrix)), 1e-300)


def line_distances(matrix: Float64s, first: Float64s, second: Float64s) -> tuple[Float64s, Float64s]:
    """Signed distances (N,) in pixels of ``second`` (N, 2) from the lines of ``first``, and the other way round."""
    b, lines_b, lines_a = _lines(matrix, first, second)
    residual = (lines_b * b).sum(axis=1)
    lengths = [np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-300) for lines in (lines_b, lines_a)]
    return residual / lengths[0], residual / lengths[1]


def sampson_distances(matrix: Float64s, first: Float64s, second: Float64s) -> Float64s:
    """(N,) signed pixels by which positions (N, 2) must move together to fulfil the constraint (Sampson)."""
    b, lines_b, lines_a = _lines(matrix, first, second)
    squares = (lines_b[:, :2] ** 2).sum(axis=1) + (lines_a[:, :2] ** 2).sum(axis=1)
    return np.asarray((b * lines_b).sum(axis=1) / np.sqrt(np.maximum(squares, 1e-300)))


def sampson_table(matrix: Float64s, first: Float64s, second: Float64s) -> Float64s:
    """(N, K) the same of every position (N, 2) with every position (K, 2)."""
    b, lines_b, lines_a = _lines(matrix, first, second)
    squares = (lines_b[:, :2] ** 2).sum(axis=1)[:, None] + (lines_a[:, :2] ** 2).sum(axis=1)[None]
    return np.asarray((lines_b @ b.T) / np.sqrt(np.maximum(squares, 1e-300)))


def _lines(matrix: Float64s, first: Float64s, second: Float64s) -> tuple[Float64s, Float64s, Float64s]:
    """(K, 3) homogeneous positions of ``second``, (N, 3) lines of ``first`` in its image, and (K, 3) back."""
    a, b = (np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) for pixels in (first, second))
    return b, a @ matrix.T, b @ matrix
