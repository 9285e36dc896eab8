"""Images as numbers that compress well, and back, without loss: what ``FrogPixels`` says, by the native library.

Images are uint8, (H, W, 3) or masks (H, W), whose rows may lie apart. They are cut into tiles of ``side`` pixels.
Numbers are contiguous uint8, those of a tile after those of another, line by line.
"""

from __future__ import annotations

from ctypes import Structure, byref

import numpy as np

from ..arrays import ImageArray
from . import structs
from .binding import check_status, library

DETAILS = 12
"""Numbers of four pixels over one of half the size."""


def predict(image: ImageArray, side: int) -> ImageArray:
    """(H * W * channels,) the numbers of an image: (channels, height, width) of each tile."""
    height, width, channels = _shape(image)
    numbers = np.empty(channels * height * width, np.uint8)
    status = library().frog_predict(byref(_pixels(image)), side, structs.address(numbers))
    check_status(status, f"packing {width} x {height} pixels")
    return numbers


def restore(numbers: ImageArray, side: int, image: ImageArray) -> None:
    """Fills an image from its numbers."""
    height, width, channels = _shape(image)
    _check(numbers, channels * height * width)
    status = library().frog_restore(structs.address(numbers), side, byref(_pixels(image, is_filled=True)))
    check_status(status, f"unpacking {width} x {height} pixels")


def predict_details(image: ImageArray, half: ImageArray, side: int) -> ImageArray:
    """(3 H W,) the numbers of an image (H, W, 3), given the one of half its size: (DETAILS, height, width) of each tile
    of that one."""
    height, width, _ = _shape(half)
    numbers = np.empty(DETAILS * height * width, np.uint8)
    pixels = byref(_pixels(image)), byref(_pixels(half))
    check_status(
        library().frog_predict_details(*pixels, side, structs.address(numbers)),
        f"packing {2 * width} x {2 * height} pixels",
    )
    return numbers


def restore_details(numbers: ImageArray, half: ImageArray, side: int, image: ImageArray) -> None:
    """Fills an image (H, W, 3) from its numbers and the image of half its size."""
    height, width, _ = _shape(half)
    _check(numbers, DETAILS * height * width)
    pixels = byref(_pixels(half)), side, byref(_pixels(image, is_filled=True))
    status = library().frog_restore_details(structs.address(numbers), *pixels)
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
