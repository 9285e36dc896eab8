"""SIFT features, and which features of which images are the same point.

They are those of a standing camera's background and of what moves at each common time, pooled, or of single images.
pycolmap finds features inside Python's lock, so that threads win nothing: several processes share the cameras.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...arrays import Array, Float32s, Float64s, ImageArray, Ints
from ...io.child_process import Progress
from ..readers.footage import state_of
from ..synchronization.films import resized
from ..synchronization.moving_points import bounds, mutual
from ..synchronization.run import WorkFolder, key_of
from ..video import load_opencv, read_gray
from .colmap import load_pycolmap, undistorted_pixels, verified
from .model import Lens
from .tracks import Pairs
from .views import LONGEST_SIDE, CameraFacts, View

BACKGROUND = -1
"""The moment of features that are there at all times."""
_PEAK = 0.003  # COLMAP's 0.0067 loses small and dark images
_MOST = 4096  # features of an image
_SMALL = 900  # pixels of the longer side up to which features are sought at twice the size as well


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
        moments = range(BACKGROUND, len(view.images))
        parts = [_of_moment(view, moment) for moment in moments]
        pixels, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
        return {
            "pixels": pixels * (np.array(camera.size) / view.background.shape[::-1]),
            "descriptors": descriptors,
            "moments": np.repeat(np.array(moments, np.int64), [len(part[0]) for part in parts]),
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
        pixels, descriptors = _sift(gray)
        return {"pixels": pixels * (np.array(size) / gray.shape[::-1]), "descriptors": descriptors}

    kept = work.kept("image", key_of(state_of(path)), found)
    return Features(kept["pixels"], kept["descriptors"], np.full(len(kept["pixels"]), BACKGROUND, np.int64))


def _of_moment(view: View, moment: int) -> tuple[Float64s, ImageArray]:
    """Those of the background outside what changes, or of what moves at one of the common times, as ``_sift`` does."""
    image = view.background if moment == BACKGROUND else view.images[moment]
    if image is None or (moment != BACKGROUND and not view.changing.any()):
        return np.empty((0, 2)), np.empty((0, 128), np.uint8)
    if moment == BACKGROUND:
        pixels, descriptors = _sift(image)
    else:  # of the rest of the image all would be thrown away
        rows, columns = bounds(view.changing)
        pixels, descriptors = _sift(image[rows, columns], max(image.shape))
        pixels = pixels + np.array([columns.start, rows.start])
    column, row = pixels.astype(int).clip(0, [image.shape[1] - 1, image.shape[0] - 1]).T
    kept = view.changing[row, column] == (moment != BACKGROUND)
    return pixels[kept], descriptors[kept]


def _sift(image: ImageArray, side: int = 0) -> tuple[Float64s, ImageArray]:
    """Pixels (N, 2) and descriptors (N, 128) by pycolmap on the CPU, of an image (H, W) or a part of one of that side.

    OpenCV's lie a quarter of a pixel to the right and below: never mix them.
    """
    pycolmap = load_pycolmap()
    options = pycolmap.FeatureExtractionOptions()
    options.sift.peak_threshold = _PEAK
    options.sift.max_num_features = _MOST
    options.sift.first_octave = -1 if (side or max(image.shape)) < _SMALL else 0
    options.use_gpu = False
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(image))
    matrix = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64).reshape(len(keypoints), -1)
    return matrix[:, :2], np.asarray(descriptors.data, np.uint8).reshape(len(keypoints), -1)


# --- matches


_RATIO = 0.8
_EXHAUSTIVE = 60
"""Images in order up to which every pair is matched."""
_OVERLAP = 10  # neighbours in time that an image is matched with, besides those 16, 32, ... images away


def pairs_to_match(count: int, *, in_order: bool = False) -> list[tuple[int, int]]:
    """Pairs of so many images to match: all, or of many images in order those of COLMAP's sequential pairing with
    quadratic overlap.
    """
    near = sorted({*range(1, _OVERLAP + 1), *(2**power for power in range(4, 12))})
    steps = near if in_order and count > _EXHAUSTIVE else range(1, count)
    return sorted((one, one + step) for one in range(count) for step in steps if one + step < count)


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
