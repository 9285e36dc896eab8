"""Half-size images at the start of a training.

A quarter of the pixels shows where things are and how they move; details are learned afterwards. At equal time a
training that begins so ends sharper, and motion has a wider basin to be found in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...frames.image_coding import halved_image
from ...frames.image_coding import is_halved as has_half


def is_halved(camera: Camera, progress: float, until: float) -> bool:
    """True where ``camera`` is drawn at half its size at ``progress``, both fractions of the training."""
    return progress < until and _is_large(camera)


def _is_large(camera: Camera) -> bool:
    return has_half(camera.height, camera.width)


def halved(camera: Camera) -> Camera:
    """The same view with half the pixels a side, rounded down."""
    return camera.resized(camera.width // 2, camera.height // 2)


def halved_capture(capture: Capture) -> Capture:
    """The same shots from cameras with half the pixels a side, but for those whose images stay as they are."""
    return capture.with_cameras(halved(each) if _is_large(each) else each for each in capture.cameras)


def sized(pixels: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 an image, or (H, W) a mask, as its camera or the halved one sees it."""
    return pixels if pixels.shape[:2] == (camera.height, camera.width) else halved_image(pixels)
