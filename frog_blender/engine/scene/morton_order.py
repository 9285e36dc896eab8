"""Gaussians that lie near each other in space, near each other in memory: caches and compression live off it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def morton_order(means: np.ndarray) -> np.ndarray:
    """(N,) an order of ``means`` (N, 3) in which neighbours follow each other: Morton's curve through them."""
    if not len(means):
        return np.empty(0, np.int64)
    least, largest = np.percentile(means, [1, 99], axis=0)  # a Gaussian far away must not put all others in one cell
    cells = ((means.clip(least, largest) - least) / np.maximum(largest - least, 1e-12) * (2**16 - 1)).astype(np.uint64)
    code = np.zeros(len(means), np.uint64)
    for bit in range(16):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def morton_order_by_range(means: np.ndarray, *bounds: int) -> np.ndarray:
    """(N,) an order of ``means`` (N, 3): the first up to each of the ``bounds``, and the others, each along a curve of
    their own."""
    edges = pairwise((0, *bounds, len(means)))
    return np.concatenate([first + morton_order(means[first:last]) for first, last in edges])
