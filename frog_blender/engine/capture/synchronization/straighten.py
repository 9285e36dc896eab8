"""Positions in a film as a lens without distortion would show them."""

from __future__ import annotations

import numpy as np

from ...arrays import Float64s
from ..camera import Camera
from ..capture import Distortion
from ..video import load_opencv


def straightened(camera: Camera, distortion: Distortion | None, positions: Float64s) -> Float64s:
    """Positions (..., 2) in pixels of ``camera``, pixel centres at +0.5, without its lens's distortion; NaN stays."""
    if distortion is None or not positions.size:
        return positions
    cv2 = load_opencv()
    lens = camera.intrinsics.copy()
    lens[:2, 2] -= 0.5  # OpenCV counts pixel centres from 0
    straight: Float64s = positions.reshape(-1, 2).copy()
    known = np.isfinite(straight).all(axis=1)
    if known.any():
        given = np.ascontiguousarray(straight[known] - 0.5)
        given[:, 0] -= distortion.skew * lens[0, 0] * (given[:, 1] - lens[1, 2]) / lens[1, 1]
        straight[known] = cv2.undistortPoints(given[:, None], lens, distortion.coefficients, P=lens)[:, 0] + 0.5
    return straight.reshape(positions.shape)
