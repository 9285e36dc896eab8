"""SIFT features, and which features of which images are the same point: mutual nearest neighbours of one geometry.

Features are those of a standing camera's background and of what moves at each common time, pooled, or of single images.
pycolmap finds features inside Python's lock, so that threads win nothing: several processes share the cameras.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray, Ints
from ...io.child_process import Progress
from ...io.work_folder import WorkFolder, key_of
from ..epipolar import mutual
from ..readers.footage import footage_at
from ..synchronization.films import resized, spread
from ..video import load_opencv, read_gray
from .colmap import load_pycolmap, undistorted_pixels, verified
from .model import Lens, Pairs
from .views import LONGEST_SIDE, CameraFacts

BACKGROUND = -1
"""The moment of features that are there at all times."""
_PEAK = 0.003  # COLMAP's 0.0067 loses small and dark images
_MOST = 4096  # features of an image
_SMALL = 900  # pixels of the longer side up to which features are sought at twice the size as well
_MARGIN = 24  # pixels around a mask that its features see
_RATIO = 0.8
_EXHAUSTIVE = 60
"""Images of one sequence up to which every pair is matched."""
_OVERLAP = 10  # neighbours in time that an image is matched with, besides those 16, 32, ... images away
_ACROSS = 600  # pairs of images of two sequences


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one camera.

    Attributes:
        pixels: (N, 2) float64 in the film's own pixels; the centre of the first is (0.5, 0.5).
        descriptors: (N, 128) uint8.
        moments: (N,) int64 index of the common time, or BACKGROUND.
    """

    pixels: Array
    descriptors: ImageArray
    moments: Ints


def view_features(work: WorkFolder, camera: CameraFacts) -> Features:
    """All features of a standing camera, in pixels of its film, of an earlier run or new."""

    def found() -> dict[str, Array]:
        view = camera.view(work)
        parts = [_within(view.background, ~view.changing), *(_within(image, view.changing) for image in view.images)]
        pixels, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
        return {
            "pixels": pixels * (np.array(camera.size) / view.background.shape[::-1]),
            "descriptors": descriptors,
            "moments": np.repeat([BACKGROUND, *view.moments], [len(part[0]) for part in parts]),
        }

    return Features(**work.kept("features", camera.key, found))


def find_features(cameras: Sequence[CameraFacts], work: WorkFolder, tell: Progress) -> None:
    """Keeps the features of standing cameras, for ``view_features``."""
    load_opencv().setNumThreads(1)  # the other processors are taken by the other processes
    for index, camera in enumerate(cameras):
        tell("features", index, len(cameras))
        view_features(work, camera)


def image_features(work: WorkFolder, path: Path, size: tuple[int, int]) -> Features:
    """The features of an image file of a camera that moves, of an earlier run or new; FrogError if it is unreadable."""

    def found() -> dict[str, Array]:
        gray = resized(read_gray(path), LONGEST_SIDE)
        pixels, descriptors = _sift(gray, max(gray.shape))
        pixels = pixels * (np.array(size) / gray.shape[::-1])
        return {"pixels": pixels, "descriptors": descriptors, "moments": np.full(len(pixels), BACKGROUND)}

    return Features(**work.kept("image", key_of(footage_at(path).state), found))


def _within(image: ImageArray, mask: Bools) -> tuple[Float64s, ImageArray]:
    """Those of an image within a mask (H, W); of the rest all would be thrown away."""
    if not mask.any():
        return np.empty((0, 2)), np.empty((0, 128), np.uint8)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left = max(int(rows[0]) - _MARGIN, 0), max(int(columns[0]) - _MARGIN, 0)
    pixels, descriptors = _sift(image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN], max(image.shape))
    pixels = pixels + np.array([left, top])
    column, row = pixels.astype(int).clip(0, [image.shape[1] - 1, image.shape[0] - 1]).T
    inside = mask[row, column]
    return pixels[inside], descriptors[inside]


def _sift(image: ImageArray, side: int) -> tuple[Float64s, ImageArray]:
    """Pixels (N, 2) and descriptors (N, 128) by pycolmap on the CPU, of an image (H, W) or a part of one of that side.

    OpenCV's lie a quarter of a pixel to the right and below: never mix them.
    """
    pycolmap = load_pycolmap()
    options = pycolmap.FeatureExtractionOptions()
    options.sift.peak_threshold = _PEAK
    options.sift.max_num_features = _MOST
    options.sift.first_octave = -1 if side < _SMALL else 0
    options.use_gpu = False
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(image))
    matrix = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64).reshape(len(keypoints), -1)
    return matrix[:, :2], np.asarray(descriptors.data, np.uint8).reshape(len(keypoints), -1)


# --- matches


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
        chosen = (spread(lengths[index], max(1, round(share * lengths[index]))) for index in (one, other))
        pairs += [(starts[one] + i, starts[other] + j) for i, j in product(*chosen)]
    return sorted(pairs)


def match_pairs(
    features: Sequence[Features], lenses: Sequence[Lens], pairs: Sequence[tuple[int, int]], tell: Progress
) -> tuple[Pairs, Pairs]:
    """The matches of pairs of images, and those that pass the two-view check."""

    def of_pair(pair: tuple[int, int]) -> tuple[Ints, Ints]:
        one, other = pair
        rows = match(features[one], features[other])
        return rows, verified(lenses[one], features[one].pixels, lenses[other], features[other].pixels, rows)

    matches, checked = {}, {}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # numpy and pycolmap compute outside Python's lock
        for index, (pair, (rows, good)) in enumerate(zip(pairs, threads.map(of_pair, pairs), strict=True)):
            tell("matches", index, len(pairs))
            matches[pair], checked[pair] = rows, good
    return matches, checked


def verified_again(matches: Pairs, pixels: Sequence[Float64s], lenses: Sequence[Lens]) -> Pairs:
    """The matches that pass the two-view check once distortion is known: before, those far off the middle fail it."""
    straight = [undistorted_pixels(lens, own) for lens, own in zip(lenses, pixels, strict=True)]
    return {
        (one, other): verified(lenses[one], straight[one], lenses[other], straight[other], rows)
        for (one, other), rows in matches.items()
    }


def match(one: Features, other: Features) -> Ints:
    """(M, 2) int64 indices of matching features; only features of one moment are compared."""
    matches = [np.empty((0, 2), np.int64)]
    for moment in np.intersect1d(one.moments, other.moments):
        here, there = np.flatnonzero(one.moments == moment), np.flatnonzero(other.moments == moment)
        if min(len(here), len(there)) > 1:
            likeness = _unit(one.descriptors[here]) @ _unit(other.descriptors[there]).T
            nearest, likest = mutual(likeness, _RATIO)
            matches.append(np.stack([here[nearest], there[likest]], axis=1))
    return np.concatenate(matches)


def _unit(descriptors: ImageArray) -> Float32s:
    values = descriptors.astype(np.float32)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6)
    return values
