"""Clusters: Gaussians that touch each other, and what hangs alone.

Two Gaussians touch when one's centre lies within the reach of the other, a few of its standard deviations. Which do is
found by grids, one for each power of two of the reach, so that small ones among large ones cost nothing.
"""

from itertools import product

import numpy as np

from ..arrays import Array
from ..gaussians import NumpyGaussians
from ..graphs import components

REACH = 3.0
"""Standard deviations (the geometric mean of the two largest) within which a Gaussian touches others."""
_LARGEST_REACH = 0.05  # of the scene's size: a larger one is fog, which would touch everything
_LEVELS = 12  # powers of two below that


def clusters(gaussians: NumpyGaussians) -> Array:
    """(N,) the cluster of each Gaussian, numbered from 0."""
    count = len(gaussians)
    if count == 0:
        return np.zeros(0, np.int64)
    points = gaussians.means.astype(np.float64)
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    most = _LARGEST_REACH * max(float(np.linalg.norm(high - low)), 1e-9)
    largest = np.sort(gaussians.scales.astype(np.float64), axis=1)[:, 1:]
    reach = np.clip(REACH * np.sqrt(largest.prod(axis=1)), most / 2**_LEVELS, most)
    level = np.clip(np.floor(np.log2(most / reach)), 0, _LEVELS).astype(int)
    pairs = [_touching(points, np.flatnonzero(level == step), most / 2.0**step) for step in np.unique(level)]
    starts, ends = np.concatenate(pairs, axis=1)
    return components(starts, ends, count)


def _touching(points: Array, own: Array, size: float) -> Array:
    """(2, P) pairs that together link the Gaussians ``own`` with all that lie in their cells of a grid, or beside."""
    cells = np.floor((points - points[own].min(0)) / size).astype(np.int64) + 1
    span = cells[own].max(0) + 2  # with a border, where neighbours are nobody's
    inside = ((cells >= 0) & (cells < span)).all(1)
    keys = np.where(inside, (cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2], -1)
    occupied, first = np.unique(keys[own], return_index=True)
    pairs, everyone = [], np.flatnonzero(inside)
    for step in product((-1, 0, 1), repeat=3):
        cell = keys[everyone] + (step[0] * span[1] + step[1]) * span[2] + step[2]
        index = np.clip(np.searchsorted(occupied, cell), 0, len(occupied) - 1)
        there = occupied[index] == cell
        pairs.append(np.stack([everyone[there], own[first[index[there]]]]))
    return np.concatenate(pairs, axis=1)
