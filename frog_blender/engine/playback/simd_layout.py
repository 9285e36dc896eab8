"""The memory layout of deformed Gaussians at playback: groups of them side by side, each group in one piece.

The native library then works on whole vectors of Gaussians, from the embeddings to the deformed attributes.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array, NetworkArrays, SceneArrays

GROUP_SIZE = 16
"""Gaussians side by side; GROUP_SIZE of the native library."""
_ROWS_AT_ONCE = GROUP_SIZE * 4096  # Gaussians that are multiplied at once, which bounds the temporary arrays
_ATTRIBUTES = ("means", "opacity_logits", "sh", "log_scales", "quaternions")  # last what does not change of all


def num_groups(count: int) -> int:
    """Groups that ``count`` Gaussians fill, the last of them perhaps not whole."""
    return -(-count // GROUP_SIZE)


def pack_lanes(arrays: SceneArrays, precomputed_first_layer: bool, *, rows_at_once: int = _ROWS_AT_ONCE) -> Array:
    """(ceil(N / GROUP_SIZE), rows, GROUP_SIZE) float32: each Gaussian's attributes and embedding as rows, a group's
    Gaussians as columns, zero beyond the last one.

    Args:
        arrays: ``means`` (N, 3), ``log_scales`` (N, 3), ``quaternions`` (N, 4), ``opacity_logits`` (N,), ``sh``
            (N, deformed coefficients, 3), ``embeddings`` (N, E) and ``embedding_weight`` (units, E).
        precomputed_first_layer: whether the embeddings' products with their weight stand in their place.
        rows_at_once: Gaussians that are packed at a time, a multiple of GROUP_SIZE; decides memory, not the result.
    """
    count, weight = len(arrays["means"]), arrays["embedding_weight"]
    columns = [arrays[name].reshape(count, math.prod(arrays[name].shape[1:])) for name in _ATTRIBUTES]
    width = sum(column.shape[1] for column in columns)
    own = len(weight) if precomputed_first_layer else weight.shape[1]
    result = np.zeros((num_groups(count), width + own, GROUP_SIZE), np.float32)
    for start in range(0, count, rows_at_once):
        some = slice(start, start + rows_at_once)
        embeddings = arrays["embeddings"][some]
        own_columns = embeddings @ weight.T if precomputed_first_layer else embeddings
        row = 0
        for column in [*(column[some] for column in columns), own_columns]:
            _put(column, result[start // GROUP_SIZE :, row : row + column.shape[1]])
            row += column.shape[1]
    return result


def _put(column: Array, rows: Array) -> None:
    """Writes (N, width) to the first of (groups, width, GROUP_SIZE)."""
    groups, rest = divmod(len(column), GROUP_SIZE)
    rows[:groups] = column[: groups * GROUP_SIZE].reshape(groups, GROUP_SIZE, column.shape[1]).transpose(0, 2, 1)
    if rest:
        rows[groups, :, :rest] = column[groups * GROUP_SIZE :].T


def transpose_weights(arrays: NetworkArrays) -> NetworkArrays:
    """The weights of the first layer and of the outputs, transposed, their rows padded to a multiple of GROUP_SIZE.

    Args:
        arrays: ``shared`` (units,), ``embedding_weight`` (units, E), ``output_weight`` (outputs, units) and
            ``output_bias`` (outputs,), and perhaps ``temporal_weight`` and ``modulation_weight`` (units, ...).
    """
    outputs = [slice(3), slice(10, None), slice(3, 10)]  # means; opacity and colours; scales and quaternions
    result: NetworkArrays = {}
    for name in ("shared", "embedding_weight", "temporal_weight", "modulation_weight", "output_weight", "output_bias"):
        if name in arrays:
            rows = arrays[name]
            if name.startswith("output"):
                rows = np.concatenate([rows[some] for some in outputs])
            padding = [(0, -len(rows) % GROUP_SIZE), *[(0, 0)] * (rows.ndim - 1)]
            result[name] = np.ascontiguousarray(np.pad(rows, padding).T, np.float32)
    return result
