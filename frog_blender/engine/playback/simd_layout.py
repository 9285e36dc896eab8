"""A finished scene's moving Gaussians as playback reads them: side by side in groups, each in one piece of memory.

The native library then works on whole vectors of Gaussians from the embeddings to the deformed attributes, and reads
the network's weights in columns.
"""

from __future__ import annotations

import math

import numpy as np

GROUP_SIZE = 16
"""PLAYED_GROUP of the native library: Gaussians that lie side by side."""
_TOGETHER = GROUP_SIZE * 4096  # Gaussians that are multiplied at once, so that what is in between stays small
_ATTRIBUTES = ("means", "opacity_logits", "sh", "log_scales", "quaternions")  # last what does not change of all


def num_groups(count: int) -> int:
    """Groups that ``count`` Gaussians fill, the last of them perhaps not whole."""
    return -(-count // GROUP_SIZE)


def pack_lanes(arrays: dict[str, np.ndarray], precomputed_first_layer: bool) -> np.ndarray:
    """(ceil(N / GROUP_SIZE), rows, GROUP_SIZE) float32: each Gaussian's attributes and embedding as rows, a group's
    Gaussians as columns, zero beyond the last one.

    Args:
        arrays: ``means`` (N, 3), ``log_scales`` (N, 3), ``quaternions`` (N, 4), ``opacity_logits`` (N,), ``sh``
            (N, deformed coefficients, 3), ``embeddings`` (N, E) and ``embedding_weight`` (units, E).
        keep_products: instead of the embeddings their products with the weights, where those are the same at all times.
    """
    count, weight = len(arrays["means"]), arrays["embedding_weight"]
    columns = [arrays[name].reshape(count, math.prod(arrays[name].shape[1:])) for name in _ATTRIBUTES]
    width = sum(column.shape[1] for column in columns)
    own = len(weight) if precomputed_first_layer else weight.shape[1]
    result = np.zeros((num_groups(count), width + own, GROUP_SIZE), np.float32)
    for start in range(0, count, _TOGETHER):
        some = slice(start, start + _TOGETHER)
        embeddings = arrays["embeddings"][some]
        values = [column[some] for column in columns] + [
            embeddings @ weight.T if precomputed_first_layer else embeddings
        ]
        rows = np.concatenate(values, axis=1).T
        rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % GROUP_SIZE))).reshape(len(rows), -1, GROUP_SIZE)
        first = start // GROUP_SIZE
        result[first : first + rows.shape[1]] = rows.transpose(1, 0, 2)
    return result


def transpose_weights(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The first layer's and the outputs' weights, turned: what is multiplied with a number lies together, in rows of
    the next multiple of GROUP_SIZE.

    Args:
        arrays: ``shared`` (units,), ``embedding_weight`` (units, E), ``output_weight`` (outputs, units) and
            ``output_bias`` (outputs,), and perhaps ``temporal_weight`` and ``modulation_weight`` (units, ...).
    """
    outputs = [slice(3), slice(10, None), slice(3, 10)]  # means; opacity and colours; scales and quaternions
    result: dict[str, np.ndarray] = {}
    for name in ("shared", "embedding_weight", "temporal_weight", "modulation_weight", "output_weight", "output_bias"):
        if name in arrays:
            rows = arrays[name]
            if name.startswith("output"):
                rows = np.concatenate([rows[some] for some in outputs])
            padding = [(0, -len(rows) % GROUP_SIZE), *[(0, 0)] * (rows.ndim - 1)]
            result[name] = np.ascontiguousarray(np.pad(rows, padding).T, np.float32)
    return result
