"""Which features of two cameras are the same point: mutual nearest neighbours that are clearly nearest."""

from __future__ import annotations

import numpy as np

from ...arrays import Float32s, ImageArray, Ints
from .features import Features

_RATIO = 0.8
_ROWS = 2048  # of the distance matrix at once


def match(one: Features, other: Features) -> Ints:
    """(M, 2) int64 indices of matching features; only features of one moment are compared."""
    found = []
    for moment in np.intersect1d(one.moments, other.moments):
        here, there = np.flatnonzero(one.moments == moment), np.flatnonzero(other.moments == moment)
        pairs = mutual_nearest(one.descriptors[here], other.descriptors[there])
        found.append(np.stack([here[pairs[:, 0]], there[pairs[:, 1]]], axis=1))
    return np.concatenate(found) if found else np.empty((0, 2), np.int64)


def mutual_nearest(one: ImageArray, other: ImageArray) -> Ints:
    """(M, 2) int64 pairs of descriptors (N, 128) uint8 that are each other's nearest, by Lowe's ratio test (2004)."""
    if len(one) < 2 or len(other) < 2:
        return np.empty((0, 2), np.int64)
    left, right = _unit(one), _unit(other)
    nearest = np.empty(len(left), np.int64)
    clear = np.empty(len(left), bool)
    best_back = np.full(len(right), -2.0, np.float32)
    back = np.zeros(len(right), np.int64)
    for top in range(0, len(left), _ROWS):
        likeness = left[top : top + _ROWS] @ right.T
        rows = np.arange(len(likeness))
        best = likeness.argmax(axis=1)
        first = likeness[rows, best]
        columns = likeness.argmax(axis=0)
        values = likeness[columns, np.arange(len(right))]
        better = values > best_back
        best_back[better], back[better] = values[better], columns[better] + top
        likeness[rows, best] = -2.0
        second = likeness.max(axis=1)
        nearest[top : top + _ROWS] = best
        clear[top : top + _ROWS] = 1 - first < _RATIO**2 * (1 - second)  # squared distances of unit vectors, halved
    chosen = np.flatnonzero(clear & (back[nearest] == np.arange(len(left))))
    return np.stack([chosen, nearest[chosen]], axis=1)


def _unit(descriptors: ImageArray) -> Float32s:
    values = descriptors.astype(np.float32)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6)
    return values
