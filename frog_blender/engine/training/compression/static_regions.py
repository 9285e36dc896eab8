"""Detects static image regions of static cameras from the temporal variance of 8x8 cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...capture.frames import FrameStore

_CELL = 8  # pixels a side: a cell's mean is nearly free of noise, and of a film's compression
_CAMERAS = 4
_IMAGES = 12, 240  # compared: of each camera where that shows motion, as it mostly does; else of all together
_LEAST_CHANGE = 3 / 255
NOISE_FACTOR = 2.0  # times what the typical cell changes by, where that is noise
_MEASURED = 16, 240  # images that variance is measured on: of each camera, and of all together, at least
_SAMPLED = 2  # every second pixel a side is enough
QUIET_QUANTILE = 0.25  # of the cells have no more noise than all have


def is_static_capture(capture: Capture, store: FrameStore) -> bool:
    """True when no part of the training images changes over time; False where no camera stands still."""
    if capture.is_moving:
        return False
    several = list(_repeated_shots(capture).values())
    chosen = [several[int(k)] for k in np.linspace(0, len(several) - 1, min(_CAMERAS, len(several)))]
    few, most = _IMAGES
    return bool(chosen) and not any(
        _changes(store, _spread(shots, count, number / _CAMERAS))
        for count in (few, max(few, most // len(chosen)))
        for number, shots in enumerate(chosen)
    )


@dataclass(frozen=True)
class TemporalVariance:
    """How much the images of each static camera change over time.

    Attributes:
        variance: (rows, columns) float32 by camera, of the display range squared: of cells' means over time, or, where
            that is more, the mean over a cell of its pixels', less the noise of the whole image. The first finds
            uniform surfaces, the second what is finer than a cell.
    """

    variance: dict[int, NDArray[np.float32]]

    def static_share(self, deviation: float) -> float:
        """The share of all cells that change by less than ``deviation`` (of the display range)."""
        cells = np.concatenate([variance.ravel() for variance in self.variance.values()])
        return float((cells < deviation**2).mean())

    def map_of(self, camera: int, height: int, width: int) -> NDArray[np.float32]:
        """(height, width) float32, each pixel with its cell's."""
        import cv2

        return np.asarray(cv2.resize(self.variance[camera], (width, height), interpolation=cv2.INTER_NEAREST))


def measure_temporal_variance(capture: Capture, store: FrameStore) -> TemporalVariance | None:
    """Of the training images; None where cameras move, or none has several images."""
    if capture.is_moving:
        return None
    several = _repeated_shots(capture)
    least, most = _MEASURED
    count = max(least, most // max(1, len(several)))
    spread = {
        camera: _spread(shots, count, number / len(several)) for number, (camera, shots) in enumerate(several.items())
    }
    return TemporalVariance({camera: _variance(store, shots) for camera, shots in spread.items()}) if several else None


def _variance(store: FrameStore, shots: list[int]) -> NDArray[np.float32]:
    """(rows, columns) of TemporalVariance.variance."""
    images = [store.image(index)[::_SAMPLED, ::_SAMPLED] for index in shots]
    cell = _CELL // _SAMPLED
    total, squares = (np.zeros(images[0].shape, np.int64) for _ in range(2))
    for image in images:
        total += image
        squares += image.astype(np.uint16) ** 2
    of_each = (squares - total**2 / len(shots)) / len(shots)
    of_pixels = _cells(of_each / 255, cell).mean(2)
    of_means = np.var([_cells(image, cell) for image in images], axis=0).mean(2)
    noise = NOISE_FACTOR * float(np.quantile(of_pixels, QUIET_QUANTILE))
    variance = np.maximum(np.maximum(of_means - noise / cell**2, of_pixels - noise), 0)
    return np.asarray(variance, dtype=np.float32)


def _repeated_shots(capture: Capture) -> dict[int, list[int]]:
    """Training shots of each camera that has several, in the cameras' order."""
    by_camera: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_camera.setdefault(capture.shots[index].camera, []).append(index)
    return {camera: shots for camera, shots in sorted(by_camera.items()) if len(shots) > 1}


def _spread(shots: list[int], most: int, shift: float) -> list[int]:
    """``most`` shots at most, over the whole film; those of cameras with another ``shift`` in [0, 1) lie between."""
    count = min(most, len(shots))
    return sorted({shots[min(int((k + shift) * len(shots) / count), len(shots) - 1)] for k in range(count)})


def _changes(store: FrameStore, shots: list[int]) -> bool:
    """Whether a camera's images change."""
    least = greatest = _cells(store.image(shots[0]))
    for index in shots[1:]:
        cells = _cells(store.image(index))
        least, greatest = np.minimum(least, cells), np.maximum(greatest, cells)
    spread = greatest - least
    typical = float(np.median(spread))  # noise, unless most of the image moves
    return typical > _LEAST_CHANGE or bool(spread.max() > max(_LEAST_CHANGE, NOISE_FACTOR * typical))


def _cells(pixels: NDArray[np.float32 | np.uint8], cell: int = _CELL) -> NDArray[np.float32]:
    """(rows, columns, 3) means in [0, 1] of whole cells of (H, W, 3) in [0, 255]; an image smaller than one is one."""
    import cv2

    height, width = pixels.shape[:2]
    size = max(1, width // cell), max(1, height // cell)
    return np.asarray(cv2.resize(pixels.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA))
