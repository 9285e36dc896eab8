"""SIFT features: of a standing camera's background and of what moves at each common time, pooled, and of single images.

pycolmap finds features inside Python's lock, so that threads win nothing: several processes share the cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...arrays import Array, Float64s, ImageArray, Ints
from ...io.child_process import Progress
from ..readers.footage import state_of
from ..synchronization.films import resized
from ..synchronization.run import WorkFolder, key_of
from ..video import load_opencv, read_gray
from .colmap import load_pycolmap
from .views import LONGEST_SIDE, CameraFacts, View

BACKGROUND = -1
"""The moment of features that are there at all times."""
_PEAK = 0.003  # COLMAP's 0.0067 loses small and dark images
_MOST = 4096  # features of an image
_SMALL = 900  # pixels of the longer side up to which features are sought at twice the size as well
_MARGIN = 24  # pixels around what changes that its features see


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
    rows, columns = (np.flatnonzero(view.changing.any(axis=axis)) for axis in (1, 0))
    if image is None or (moment != BACKGROUND and not len(rows)):
        return np.empty((0, 2)), np.empty((0, 128), np.uint8)
    if moment == BACKGROUND:
        pixels, descriptors = _sift(image)
    else:  # of the rest of the image all would be thrown away
        top, left = max(int(rows[0]) - _MARGIN, 0), max(int(columns[0]) - _MARGIN, 0)
        pixels, descriptors = _sift(image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN], max(image.shape))
        pixels = pixels + np.array([left, top])
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
