"""The border between the video's display-referred sRGB and Blender's scene-linear colour (Rec. 709 primaries)."""

from __future__ import annotations

import functools

import numpy as np

_STEPS = 65535  # of the table for pictures


def picture_to_linear(display: np.ndarray) -> np.ndarray:
    """``to_linear`` of many float32 values in [0, 1] by a table: five times faster, and exact to 2e-5."""
    index = display * np.float32(_STEPS)
    index += np.float32(0.5)
    return _table()[index.astype(np.uint16)]


@functools.cache
def _table() -> np.ndarray:
    return to_linear(np.arange(_STEPS + 1) / _STEPS)


def to_linear(display: np.ndarray) -> np.ndarray:
    """Scene-linear float32 of display-referred sRGB, any shape; values above one continue along the same curve."""
    display = np.maximum(np.asarray(display, dtype=np.float32), 0.0)
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_display(linear: np.ndarray) -> np.ndarray:
    """Display-referred sRGB float32 of scene-linear colour, any shape: the inverse of ``to_linear``."""
    linear = np.maximum(np.asarray(linear, dtype=np.float32), 0.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055).astype(np.float32)
