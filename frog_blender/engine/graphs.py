"""Connected components of graphs."""

import numpy as np

from .arrays import Array


def components(starts: Array, ends: Array, count: int) -> Array:
    """(count,) numbers of the connected components of a graph: each takes the least of its neighbours' until none
    changes, with shortcuts (Shiloach and Vishkin, 1982)."""
    label = np.arange(count)
    while True:
        least = np.minimum(label[starts], label[ends])
        before = label.copy()
        np.minimum.at(label, label[starts], least)
        np.minimum.at(label, label[ends], least)
        np.minimum.at(label, starts, least)
        np.minimum.at(label, ends, least)
        while not np.array_equal(shorter := label[label], label):
            label = shorter
        if np.array_equal(label, before):
            return np.asarray(np.unique(label, return_inverse=True)[1])
