"""Connected components of graphs."""

import numpy as np

from .arrays import Array

_PAIRS_AT_ONCE = 1 << 15  # numpy keeps other threads waiting for as long as one ``minimum.at`` takes


def components(starts: Array, ends: Array, count: int) -> Array:
    """(count,) numbers of the connected components of a graph: each takes the least of its neighbours' until none
    changes, with shortcuts (Shiloach and Vishkin, 1982)."""
    label = np.arange(count)
    while True:
        starts, ends = label[starts], label[ends]
        apart = starts != ends
        if not apart.any():
            return np.asarray(np.unique(label, return_inverse=True)[1])
        starts, ends = starts[apart], ends[apart]
        for first in range(0, len(starts), _PAIRS_AT_ONCE):
            some, others = (part[first : first + _PAIRS_AT_ONCE] for part in (starts, ends))
            np.minimum.at(label, np.maximum(some, others), np.minimum(some, others))
        while not np.array_equal(shorter := label[label], label):
            label = shorter
