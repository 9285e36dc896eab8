"""Whether anything moves at all, from the pictures alone: where nothing does, no motion is learned."""

from __future__ import annotations

import numpy as np

from ..capture.capture import Capture
from ..capture.frames import FrameStore

_CELL = 8  # pixels a side: a cell's mean is nearly free of noise, and of a film's compression
_CAMERAS, _MOMENTS = 4, 12
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
    return bool(chosen) and not any(_changes(store, shots, number) for number, shots in enumerate(chosen))


def _changes(store: FrameStore, shots: list[int], number: int) -> bool:
    """Whether a camera's pictures change; each camera is looked at at other moments than the one before it."""
    count = min(_MOMENTS, len(shots))
    shift = number / _CAMERAS
    picked = sorted({shots[min(int((k + shift) * len(shots) / count), len(shots) - 1)] for k in range(count)})
    cells = np.stack([_cells(store.image(index)) for index in picked])
    spread = cells.max(axis=0) - cells.min(axis=0)
    typical = float(np.median(spread))  # noise, unless most of the picture moves
    return typical > _LEAST_CHANGE or bool(spread.max() > max(_LEAST_CHANGE, _OF_NOISE * typical))


def _cells(pixels: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) means in [0, 1] of whole cells of (H, W, 3) uint8; a picture smaller than one is one."""
    import cv2

    height, width = pixels.shape[:2]
    size = max(1, width // _CELL), max(1, height // _CELL)
    return cv2.resize(pixels.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA)
