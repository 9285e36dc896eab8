"""SIFT features: of a standing camera's background and of what moves at each common time, pooled, and of single images.

pycolmap finds features inside Python's lock, so that threads win nothing: several processes share the images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Array, Bools, Float32s, ImageArray, Ints
from ..video import load_opencv, read_gray
from .colmap import load_pycolmap
from .films import View, resized
from .work_folder import WorkFolder, key_of, key_of_file

BACKGROUND = -1
"""The moment of features that are there at all times."""
_PEAK = 0.003  # COLMAP's 0.0067 loses small and dark images
_MOST = 4096  # features of an image
_SMALL = 900  # pixels of the longer side up to which features are sought at twice the size as well
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


def missing_features(work: WorkFolder, view: View) -> list[int]:
    """The moments, BACKGROUND among them, whose features were not kept yet."""
    moments = range(BACKGROUND, len(view.images))
    return [moment for moment in moments if not work.file("features", _key(view, moment)).is_file()]


def view_features(work: WorkFolder, view: View) -> Features:
    """All features of a standing camera, in pixels of its film: each moment's of an earlier run or new."""
    parts = [moment_features(work, view, moment) for moment in range(BACKGROUND, len(view.images))]
    return Features(
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.moments for part in parts]),
    )


def moment_features(work: WorkFolder, view: View, moment: int) -> Features:
    """Those of the background outside what changes, or of what moves at one of the common times."""
    key = _key(view, moment)
    kept = work.load("features", key)
    if kept is None:
        found = _of_background(view) if moment == BACKGROUND else _of_moment(view, moment)
        kept = {"pixels": found.pixels, "descriptors": found.descriptors, "moments": found.moments}
        work.keep("features", key, kept)
    return Features(kept["pixels"], kept["descriptors"], kept["moments"])


def image_features(work: WorkFolder, path: Path, size: tuple[int, int]) -> Features:
    """The features of an image file of a camera that moves, of an earlier run or new; FrogError if it is unreadable."""
    key = key_of(key_of_file(path))
    kept = work.load("image", key)
    if kept is None:
        gray = resized(read_gray(path), size)
        pixels, descriptors = _Extractor(gray).of(gray)
        kept = {"pixels": pixels.astype(np.float64) * (np.array(size) / gray.shape[::-1]), "descriptors": descriptors}
        work.keep("image", key, kept)
    return Features(kept["pixels"], kept["descriptors"], np.full(len(kept["pixels"]), BACKGROUND, np.int64))


def _key(view: View, moment: int) -> str:
    if moment == BACKGROUND:
        return key_of(view.background, view.changing)
    images = [np.empty(0) if image is None else image for image in (view.images[moment], view.nexts[moment])]
    return key_of(*images, view.shares[moment], view.changing, moment)


def _of_background(view: View) -> Features:
    return _scaled(_kept(*_Extractor(view.background).of(view.background), ~view.changing, BACKGROUND), view)


def _of_moment(view: View, moment: int) -> Features:
    """None where the film has no image then."""
    image = view.images[moment]
    if image is None or not view.changing.any():
        return Features(np.empty((0, 2)), np.empty((0, 128), np.uint8), np.empty(0, np.int64))
    found = _kept(*_within(_Extractor(image), image, view.changing), view.changing, moment)
    return _scaled(_carried(found, image, view.nexts[moment], abs(view.shares[moment])), view)


def _scaled(found: Features, view: View) -> Features:
    """From pixels of the view's images to those of its film."""
    return replace(found, pixels=found.pixels * (np.array(view.size) / view.background.shape[::-1]))


class _Extractor:
    """pycolmap's SIFT on the CPU. OpenCV's lies a quarter of a pixel to the right and below: never mix them."""

    def __init__(self, example: ImageArray) -> None:
        """Args: example: an image (H, W) of the size that is to come: small ones are searched at twice theirs too."""
        pycolmap = load_pycolmap()
        options = pycolmap.FeatureExtractionOptions()
        options.sift.peak_threshold = _PEAK
        options.sift.max_num_features = _MOST
        options.sift.first_octave = -1 if max(example.shape) < _SMALL else 0
        options.use_gpu = False
        self._extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
        self._as_matrix = pycolmap.keypoints_to_matrix

    def of(self, image: ImageArray) -> tuple[Float32s, ImageArray]:
        """Pixels (N, 2) float32 and descriptors (N, 128) uint8 of an image (H, W) uint8."""
        keypoints, descriptors = self._extractor.extract_from_uint8_array(np.ascontiguousarray(image))
        matrix = np.asarray(self._as_matrix(keypoints), np.float32).reshape(len(keypoints), -1)
        return matrix[:, :2], np.asarray(descriptors.data, np.uint8).reshape(len(keypoints), -1)


def _within(extractor: _Extractor, image: ImageArray, changing: Bools) -> tuple[Float32s, ImageArray]:
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
