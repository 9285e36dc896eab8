"""Lenses that see more than a pinhole camera can, and the pinhole camera that takes the place of each.

A model turns the direction (x, y, 1) of a ray in the camera's axes into a position in the image at focal length 1, from
the principal point:

- ``fisheye``, k1 k2 k3 k4: OpenCV's (``cv2.fisheye``) and COLMAP's OPENCV_FISHEYE. The angle theta to the axis becomes
  the distance theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).
- ``thin_prism_fisheye``, k1 k2 p1 p2 k3 k4 sx1 sy1: COLMAP's THIN_PRISM_FISHEYE, the same with tangential and thin
  prism terms in the coordinates of the angle.
- ``fov``, omega: COLMAP's FOV, distance atan(2 r tan(omega / 2)) / omega (Devernay and Faugeras 2001).
"""

import math
from functools import lru_cache

import numpy as np

from ..arrays import Float64s

FISHEYE, THIN_PRISM_FISHEYE, FOV = "fisheye", "thin_prism_fisheye", "fov"
WIDEST = math.radians(110)
"""Field of view of a pinhole camera along its longer side, at most: beyond it most pixels are spent on the corners."""
_NARROWEST = math.radians(5)
_BORDER, _RADII = 33, 33  # samples


def bend(model: str, coefficients: Float64s, rays: Float64s) -> Float64s:
    """Image positions (..., 2) at focal length 1 of the rays (x, y, 1), given as (..., 2)."""
    radius = np.linalg.norm(rays, axis=-1, keepdims=True)
    safe = np.maximum(radius, 1e-12)
    bent: Float64s
    if model == FOV:
        omega = float(coefficients[0])
        longer = np.where(radius > 1e-9, np.arctan(2 * safe * math.tan(omega / 2)) / (safe * omega), 1.0)
        return np.asarray(rays * longer)
    angle = np.arctan(radius)
    flat = rays * np.where(radius > 1e-9, angle / safe, 1.0)
    square = angle * angle
    k1, k2, k3, k4 = coefficients if model == FISHEYE else coefficients[[0, 1, 4, 5]]
    bent = flat * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4))))
    if model == THIN_PRISM_FISHEYE:
        p1, p2, sx1, sy1 = coefficients[[2, 3, 6, 7]]
        x, y = flat[..., :1], flat[..., 1:]
        across = 2 * p1 * x * y + p2 * (square + 2 * x * x) + sx1 * square
        down = 2 * p2 * x * y + p1 * (square + 2 * y * y) + sy1 * square
        bent = bent + np.concatenate([across, down], axis=-1)
    return bent


def pinhole_for(model: str, coefficients: Float64s, lens: Float64s, size: tuple[int, int]) -> Float64s | None:
    """(3, 3) K of the widest pinhole camera, of at most 110 degrees, all of whose pixels the lens saw.

    It has square pixels and its principal point in the middle. None where there is no such camera: the lens' distances
    do not grow with the angle, or its image lies elsewhere.

    Args:
        lens: (3, 3) K of the stored image, pixels.
        size: width and height of both images in pixels.
    """
    return _pinhole(model, tuple(coefficients.tolist()), tuple(map(tuple, lens.tolist())), size)


@lru_cache(maxsize=256)  # a moving camera has one lens and thousands of images
def _pinhole(
    model: str, values: tuple[float, ...], rows: tuple[tuple[float, ...], ...], size: tuple[int, int]
) -> Float64s | None:
    coefficients, lens = np.array(values), np.array(rows)
    half = max(size) / 2
    low = shortest = half / math.tan(WIDEST / 2)
    longest = half / math.tan(_NARROWEST / 2)
    with np.errstate(all="ignore"):  # coefficients may be anything: what is not finite is not seen
        while not _sees(model, coefficients, lens, size, low):
            low *= 1.25
            if low > longest:
                return None
        high, low = low, low / 1.25
        for _ in range(0 if high == shortest else 30):
            middle = (low + high) / 2
            is_seen = _sees(model, coefficients, lens, size, middle)
            low, high = (low, middle) if is_seen else (middle, high)
    pinhole = np.array([[high, 0.0, size[0] / 2], [0.0, high, size[1] / 2], [0.0, 0.0, 1.0]])
    pinhole.flags.writeable = False
    return pinhole


def _sees(model: str, coefficients: Float64s, lens: Float64s, size: tuple[int, int], focal: float) -> bool:
    """Whether the lens shows all that a pinhole camera of this focal length does, each ray farther out than the one
    within it."""
    width, height = size
    across, down = np.linspace(-width / 2, width / 2, _BORDER), np.linspace(-height / 2, height / 2, _BORDER)
    border = np.concatenate(
        [np.stack([across, np.full(_BORDER, y)], 1) for y in down[[0, -1]]]
        + [np.stack([np.full(_BORDER, x), down], 1) for x in across[[0, -1]]]
    )
    rays = border[:, None] * np.linspace(0, 1, _RADII)[:, None] / focal  # (border, radius, 2)
    bent = bend(model, coefficients, rays)
    if not np.isfinite(bent).all() or (np.diff(np.linalg.norm(bent, axis=2), axis=1) <= 0).any():
        return False
    pixels = bent[:, -1] @ lens[:2, :2].T + lens[:2, 2]
    return bool((pixels >= -1e-6).all() and (pixels <= np.array(size) + 1e-6).all())
