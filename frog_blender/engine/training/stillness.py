"""Whether anything moves at all, from the pictures alone: where nothing does, no motion is learned."""

from __future__ import annotations

import numpy as np

from ..capture.capture import Capture
from ..capture.frames import FrameStore

_CELL = 8  # pixels a side: a cell's mean is nearly free of noise, and of a film's compression
_CAMERAS = 4
_PICTURES = 12, 240  # looked at: of each camera where that shows motion, as it mostly does; else of all together
_LEAST_CHANGE = 3 / 255
_OF_NOISE = 2.0  # times what the typical cell changes by, where that is noise


def nothing_moves(capture: Capture, store: FrameStore) -> bool:
    """True when no part of the training pictures changes over time; False where no camera stands still."""
    if capture.is_moving:
        return False
    by_camera: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_camera.setdefault(capture.shots[index].camera, []).append(index)
    several = [shots for _, shots in sorted(by_camera.items()) if len(shots) > 1]
    chosen = [several[int(k)] for k in np.linspace(0, len(several) - 1, min(_CAMERAS, len(several)))]
    few, most = _PICTURES
    return bool(chosen) and not any(
        _changes(store, _spread(shots, count, number / _CAMERAS))
        for count in (few, max(few, most // len(chosen)))
        for number, shots in enumerate(chosen)
    )


def _spread(shots: list[int], most: int, shift: float) -> list[int]:
    """``most`` shots at most, over the whole film; those of cameras with another ``shift`` in [0, 1) lie between."""
    count = min(most, len(shots))
    return sorted({shots[min(int((k + shift) * len(shots) / count), len(shots) - 1)] for k in range(count)})


def _changes(store: FrameStore, shots: list[int]) -> bool:
    """Whether a camera's pictures change."""
    least = greatest = _cells(store.image(shots[0]))
    for index in shots[1:]:
        cells = _cells(store.image(index))
        least, greatest = np.minimum(least, cells), np.maximum(greatest, cells)
    spread = greatest - least
    typical = float(np.median(spread))  # noise, unless most of the picture moves
    return typical > _LEAST_CHANGE or bool(spread.max() > max(_LEAST_CHANGE, _OF_NOISE * typical))


def _cells(pixels: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) means in [0, 1] of whole cells of (H, W, 3) uint8; a picture smaller than one is one."""
    import cv2

    height, width = pixels.shape[:2]
    size = max(1, width // _CELL), max(1, height // _CELL)
    return cv2.resize(pixels.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA)
