"""Images as numbers that compress well, and back, without loss: what ``FrogPixels`` says, by the native library.

Images are uint8, (H, W, 3) or masks (H, W), whose rows may lie apart; numbers are contiguous uint8.
"""

from __future__ import annotations

from ctypes import Structure, byref

import numpy as np

from ..arrays import ImageArray
from . import structs
from .binding import check_status, library

DETAILS = 12
"""Numbers of four pixels over one of half the size."""


def predict(image: ImageArray) -> ImageArray:
    """(channels, H, W) the numbers of an image."""
    height, width, channels = _shape(image)
    numbers = np.empty((channels, height, width), np.uint8)
    status = library().frog_predict(byref(_pixels(image)), structs.address(numbers))
    check_status(status, f"packing {width} x {height} pixels")
    return numbers


def restore(numbers: ImageArray, image: ImageArray) -> None:
    """Fills an image from its numbers."""
    height, width, channels = _shape(image)
    _check(numbers, channels * height * width)
    status = library().frog_restore(structs.address(numbers), byref(_pixels(image, is_filled=True)))
    check_status(status, f"unpacking {width} x {height} pixels")


def predict_details(image: ImageArray, half: ImageArray) -> ImageArray:
    """(12, H / 2, W / 2) the numbers of an image (H, W, 3), given the one of half its size."""
    height, width, _ = _shape(half)
    numbers = np.empty((DETAILS, height, width), np.uint8)
    status = library().frog_predict_details(byref(_pixels(image)), byref(_pixels(half)), structs.address(numbers))
    check_status(status, f"packing {2 * width} x {2 * height} pixels")
    return numbers


def restore_details(numbers: ImageArray, half: ImageArray, image: ImageArray) -> None:
    """Fills an image (H, W, 3) from its numbers and the image of half its size."""
    height, width, _ = _shape(half)
    _check(numbers, DETAILS * height * width)
    pixels = _pixels(image, is_filled=True)
    status = library().frog_restore_details(structs.address(numbers), byref(_pixels(half)), byref(pixels))
    check_status(status, f"unpacking {2 * width} x {2 * height} pixels")


def _shape(image: ImageArray) -> tuple[int, int, int]:
    """Height, width and channels."""
    height, width = image.shape[:2]
    return height, width, 1 if image.ndim == 2 else image.shape[2]


def _check(numbers: ImageArray, size: int) -> None:
    if numbers.dtype != np.uint8 or numbers.size != size or not numbers.flags.c_contiguous:
        raise ValueError(f"expected {size} contiguous bytes, found {numbers.size} of {numbers.dtype}")


def _pixels(image: ImageArray, *, is_filled: bool = False) -> Structure:
    """``FrogPixels``; ValueError for an array that it cannot name."""
    height, width, channels = _shape(image)
    across = image.strides[1:] == ((1,) if image.ndim == 2 else (channels, 1))
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or not across or image.strides[0] < width * channels:
        raise ValueError(f"expected rows of bytes, found {image.shape} of {image.dtype}, strides {image.strides}")
    if is_filled and not image.flags.writeable:
        raise ValueError("expected an image that may be written")
    return structs.Pixels(structs.address(image[:1]), image.strides[0], height, width, channels)
