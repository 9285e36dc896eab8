"""Which features of which images are the same point: mutual nearest neighbours that agree with one geometry."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations, product

import numpy as np

from ...arrays import Float32s, Float64s, ImageArray, Ints
from ...io.child_process import Progress
from ..epipolar import mutual
from .colmap import undistorted_pixels, verified
from .features import Features
from .model import Lens
from .tracks import Pairs

_RATIO = 0.8
_EXHAUSTIVE = 60
"""Images of one sequence up to which every pair is matched."""
_OVERLAP = 10  # neighbours in time that an image is matched with, besides those 16, 32, ... images away
_ACROSS = 600  # pairs of images of two sequences


def pairs_to_match(lengths: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of images to match, of sequences one after the other, a camera that stands being one of one image.

    Within a sequence they are those of COLMAP's sequential pairing with quadratic overlap, between two all of few, else
    those of evenly spread images.
    """
    starts = np.cumsum([0, *lengths]).tolist()
    steps = sorted({*range(1, _OVERLAP + 1), *(2**power for power in range(4, 12))})
    pairs: list[tuple[int, int]] = []
    for start, length in zip(starts, lengths, strict=False):
        near = range(1, length) if length <= _EXHAUSTIVE else steps
        pairs += [(start + one, start + one + step) for one in range(length) for step in near if one + step < length]
    for one, other in combinations(range(len(lengths)), 2):
        share = min(1.0, (_ACROSS / (lengths[one] * lengths[other])) ** 0.5)
        spread = [
            np.unique(np.linspace(0, lengths[index] - 1, max(1, round(share * lengths[index]))).round().astype(int))
            for index in (one, other)
        ]
        pairs += [(starts[one] + i, starts[other] + j) for i, j in product(*(images.tolist() for images in spread))]
    return sorted(pairs)


def match_pairs(
    features: Sequence[Features], lenses: Sequence[Lens], pairs: Sequence[tuple[int, int]], tell: Progress
) -> tuple[Pairs, Pairs]:
    """The matches of pairs of images, and those that pass the two-view check."""

    def of_pair(pair: tuple[int, int]) -> tuple[Ints, Ints]:
        one, other = pair
        found = match(features[one], features[other])
        return found, verified(lenses[one], features[one].pixels, lenses[other], features[other].pixels, found)

    matches, checked = {}, {}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # numpy and pycolmap compute outside Python's lock
        for index, (pair, (found, good)) in enumerate(zip(pairs, threads.map(of_pair, pairs), strict=True)):
            tell("matches", index, len(pairs))
            matches[pair], checked[pair] = found, good
    return matches, checked


def verified_again(matches: Pairs, pixels: Sequence[Float64s], lenses: Sequence[Lens]) -> Pairs:
    """The matches that pass the two-view check once distortion is known: before, those far off the middle fail it."""
    straight = [undistorted_pixels(lens, own) for lens, own in zip(lenses, pixels, strict=True)]
    return {
        (one, other): verified(lenses[one], straight[one], lenses[other], straight[other], found)
        for (one, other), found in matches.items()
    }


def match(one: Features, other: Features) -> Ints:
    """(M, 2) int64 indices of matching features; only features of one moment are compared."""
    found = [np.empty((0, 2), np.int64)]
    for moment in np.intersect1d(one.moments, other.moments):
        here, there = np.flatnonzero(one.moments == moment), np.flatnonzero(other.moments == moment)
        if min(len(here), len(there)) > 1:
            likeness = _unit(one.descriptors[here]) @ _unit(other.descriptors[there]).T
            nearest, farther = mutual(likeness, _RATIO)
            found.append(np.stack([here[nearest], there[farther]], axis=1))
    return np.concatenate(found)


def _unit(descriptors: ImageArray) -> Float32s:
    values = descriptors.astype(np.float32)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6)
    return values
