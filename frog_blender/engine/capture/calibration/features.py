"""SIFT features of a camera, pooled: those of its background, and those of what moves at each common time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array, Bools, Float32s, ImageArray, Ints
from ..video import load_opencv
from .colmap import load_pycolmap
from .films import View

BACKGROUND = -1
"""The moment of features that are there at all times."""
_PEAK = 0.003  # COLMAP's 0.0067 loses small and dark images
_MOST = 4096  # features of an image
SMALL = 900
"""Pixels of the longer side up to which features are sought at twice the size as well."""
_MARGIN = 24  # pixels around what changes that its features see
_LEAST_SHIFT = 1e-3  # of a frame


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


def background_features(view: View) -> Features:
    """The features of a standing camera's plate, outside what changes; in pixels of the film."""
    extractor = Extractor(upsampled=max(view.plate.shape) < SMALL)
    return _scaled(_kept(*extractor.of(view.plate), ~view.changing, BACKGROUND), view)


def moment_features(view: View, moment: int) -> Features:
    """Those of what moves at one of the common times, none where the film has no image then; in pixels of the film."""
    image = view.images[moment]
    if image is None or not view.changing.any():
        return Features(np.empty((0, 2)), np.empty((0, 128), np.uint8), np.empty(0, np.int64))
    extractor = Extractor(upsampled=max(view.plate.shape) < SMALL)
    found = _kept(*_within(extractor, image, view.changing), view.changing, moment)
    return _scaled(_carried(found, image, view.nexts[moment], abs(view.shares[moment])), view)


def pooled(parts: Sequence[Features]) -> Features:
    """All of them as one camera's."""
    return Features(
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.moments for part in parts]),
    )


def _scaled(found: Features, view: View) -> Features:
    """From pixels of the view's images to those of its film."""
    return replace(found, pixels=found.pixels * (np.array(view.size) / view.plate.shape[::-1]))


class Extractor:
    """pycolmap's SIFT on the CPU. OpenCV's lies a quarter of a pixel to the right and below: never mix them."""

    def __init__(self, *, upsampled: bool) -> None:
        """Args: upsampled: features are sought at twice the size as well, which small images need."""
        pycolmap = load_pycolmap()
        options = pycolmap.FeatureExtractionOptions()
        options.sift.peak_threshold = _PEAK
        options.sift.max_num_features = _MOST
        options.sift.first_octave = -1 if upsampled else 0
        options.use_gpu = False
        self._extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
        self._as_matrix = pycolmap.keypoints_to_matrix

    def of(self, image: ImageArray) -> tuple[Float32s, ImageArray]:
        """Pixels (N, 2) float32 and descriptors (N, 128) uint8 of an image (H, W) uint8."""
        keypoints, descriptors = self._extractor.extract_from_uint8_array(np.ascontiguousarray(image))
        matrix = np.asarray(self._as_matrix(keypoints), np.float32).reshape(len(keypoints), -1)
        return matrix[:, :2], np.asarray(descriptors.data, np.uint8).reshape(len(keypoints), -1)


def _within(extractor: Extractor, image: ImageArray, changing: Bools) -> tuple[Float32s, ImageArray]:
    """The features of the part of an image in which something changes: the rest would be thrown away."""
    rows, columns = np.flatnonzero(changing.any(axis=1)), np.flatnonzero(changing.any(axis=0))
    top, left = max(int(rows[0]) - _MARGIN, 0), max(int(columns[0]) - _MARGIN, 0)
    pixels, descriptors = extractor.of(image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN])
    return pixels + np.array([left, top], np.float32), descriptors


def _kept(pixels: Float32s, descriptors: ImageArray, allowed: Bools, moment: int) -> Features:
    """Those of an image's features that lie in the allowed pixels (H, W)."""
    height, width = allowed.shape
    column, row = pixels.astype(int).clip(0, [width - 1, height - 1]).T
    keep = allowed[row, column]
    return Features(
        pixels[keep].astype(np.float64), descriptors[keep], np.full(int(keep.sum()), moment, dtype=np.int64)
    )


def _carried(found: Features, image: ImageArray, towards: ImageArray | None, share: float) -> Features:
    """Features moved along the optical flow to ``share`` of the way to a neighbouring image; lost ones are left out."""
    if towards is None or share < _LEAST_SHIFT or not len(found.pixels):
        return found
    cv2 = load_opencv()
    begin = (found.pixels - 0.5).astype(np.float32)[:, None]
    window = {"winSize": (15, 15), "maxLevel": 3}
    ends, ahead, _ = cv2.calcOpticalFlowPyrLK(image, towards, begin, None, **window)
    back, behind, _ = cv2.calcOpticalFlowPyrLK(towards, image, ends, None, **window)
    sure = (ahead[:, 0] > 0) & (behind[:, 0] > 0) & (np.linalg.norm(back - begin, axis=-1)[:, 0] < 0.5)
    moved = found.pixels + share * (ends - begin)[:, 0]
    return Features(moved[sure], found.descriptors[sure], found.moments[sure])
