"""Images as numbers that compress well, and back, without loss: what ``FrogPixels`` says, by the native library.

Images are uint8, (H, W, 3) or masks (H, W), whose rows may lie apart. They are cut into tiles of ``side`` pixels.
Numbers are contiguous uint8, those of a tile after those of another, line by line.
"""

from ctypes import Structure, byref

import numpy as np

from ..arrays import ImageArray
from . import structs
from .binding import check_status, library


def predict(image: ImageArray, side: int) -> ImageArray:
    """The numbers of an image, as many as its bytes: (channels, height, width) of each tile."""
    numbers = np.empty(image.size, np.uint8)
    status = library().frog_predict(byref(_pixels(image)), side, structs.address(numbers))
    check_status(status, f"packing {image.shape[1]} x {image.shape[0]} pixels")
    return numbers


def restore(numbers: ImageArray, side: int, image: ImageArray) -> None:
    """Fills an image from its numbers."""
    if numbers.dtype != np.uint8 or numbers.size != image.size or not numbers.flags.c_contiguous:
        raise ValueError(f"expected {image.size} contiguous bytes, found {numbers.size} of {numbers.dtype}")
    if not image.flags.writeable:
        raise ValueError("expected an image that may be written")
    status = library().frog_restore(structs.address(numbers), side, byref(_pixels(image)))
    check_status(status, f"unpacking {image.shape[1]} x {image.shape[0]} pixels")


def _pixels(image: ImageArray) -> Structure:
    """``FrogPixels``; ValueError for an array that it cannot name."""
    height, width = image.shape[:2]
    channels = 1 if image.ndim == 2 else image.shape[2]
    across = image.strides[1:] == ((1,) if image.ndim == 2 else (channels, 1))
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or not across or image.strides[0] < width * channels:
        raise ValueError(f"expected rows of bytes, found {image.shape} of {image.dtype}, strides {image.strides}")
    return structs.Pixels(structs.address(image[:1]), image.strides[0], height, width, channels)
