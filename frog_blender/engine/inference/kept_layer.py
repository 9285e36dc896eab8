"""The part of the deformation network that does not depend on time, computed once for a finished scene."""

from __future__ import annotations

import numpy as np

GROUP = 16
"""KEPT_GROUP of the native library: Gaussians that lie side by side."""
_TOGETHER = GROUP * 4096  # Gaussians that are multiplied at once, so that what is in between stays small


def kept_first_layer(embeddings: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N / GROUP rounded up, units, GROUP) float32: the embeddings times the first layer's weights, the Gaussians of a
    group in the last dimension, zero beyond the last one.

    Args:
        embeddings: (N, E).
        weight: (units, E).
    """
    count, units = len(embeddings), len(weight)
    result = np.zeros((-(-count // GROUP), units, GROUP), np.float32)
    for start in range(0, count, _TOGETHER):
        product = weight @ embeddings[start : start + _TOGETHER].T  # (units, Gaussians)
        product = np.pad(product, ((0, 0), (0, -product.shape[1] % GROUP))).reshape(units, -1, GROUP)
        first = start // GROUP
        result[first : first + product.shape[1]] = product.transpose(1, 0, 2)
    return result
