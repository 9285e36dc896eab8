"""Whether anything moves at all, from the pictures alone: where nothing does, no motion is learned."""

from __future__ import annotations

import numpy as np

from ..capture.capture import Capture
from ..capture.frames import FrameStore

_CELL = 8  # pixels a side: a cell's mean is nearly free of noise, and of a film's compression
_CAMERAS, _MOMENTS = 4, 12
_LEAST_CHANGE = 3 / 255
_OF_NOISE = 6.0  # times what the typical cell changes by


def nothing_moves(capture: Capture, store: FrameStore) -> bool:
    """True when no part of the training pictures changes over time; False where no camera stands still."""
    if capture.is_moving:
        return False
    by_camera: dict[int, list[int]] = {}
    for index, shot in enumerate(capture.shots):
        if not capture.is_test(shot):
            by_camera.setdefault(shot.camera, []).append(index)
    several = [shots for _, shots in sorted(by_camera.items()) if len(shots) > 1]
    chosen = [several[int(k)] for k in np.linspace(0, len(several) - 1, min(_CAMERAS, len(several)))]
    return bool(chosen) and not any(_changes(store, shots) for shots in chosen)


def _changes(store: FrameStore, shots: list[int]) -> bool:
    picked = [shots[int(k)] for k in np.linspace(0, len(shots) - 1, min(_MOMENTS, len(shots)))]
    cells = np.stack([_cells(store.image(index)) for index in picked])
    spread = cells.max(axis=0) - cells.min(axis=0)
    return bool(spread.max() > max(_LEAST_CHANGE, _OF_NOISE * float(np.median(spread))))


def _cells(pixels: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) means in [0, 1] of whole cells of (H, W, 3) uint8; a picture smaller than one is one."""
    import cv2

    height, width = pixels.shape[:2]
    size = max(1, width // _CELL), max(1, height // _CELL)
    return cv2.resize(pixels.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA)
