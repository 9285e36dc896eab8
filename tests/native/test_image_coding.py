"""Images as numbers that compress well: the native library against numpy, and back to the bit."""

from collections.abc import Callable

import numpy as np
import pytest

from frog_blender.engine.native.image_coding import predict, restore

SIZES = [(1, 1), (1, 7), (5, 1), (16, 16), (37, 53), (70, 66)]
SIDES = [1, 16, 64, 1000]


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(len(shape) + sum(shape)).integers(0, 256, shape).astype(np.uint8)


def planes(image: np.ndarray) -> np.ndarray:
    """(channels, H, W): green, red less green and blue less green; a mask is one plane."""
    if image.ndim == 2:
        return image[None]
    red, green, blue = np.moveaxis(image, 2, 0)
    return np.stack([green, red - green, blue - green])


def tiles(image: np.ndarray, side: int) -> list[np.ndarray]:
    height, width = image.shape[:2]
    return [image[y : y + side, x : x + side] for y in range(0, height, side) for x in range(0, width, side)]


def differences(image: np.ndarray, side: int) -> np.ndarray:
    """The reference of ``predict``."""
    numbers = []
    for tile in tiles(image, side):
        beside = np.diff(planes(tile), axis=2, prepend=np.uint8(0))
        numbers.append(np.diff(beside, axis=1, prepend=np.uint8(0)).ravel())
    return np.concatenate(numbers)


def check(image: np.ndarray, side: int, expected: np.ndarray) -> None:
    numbers = predict(image, side)
    assert np.array_equal(numbers, expected), (image.shape, side)
    restored = np.full_like(image, 77)
    restore(numbers, side, restored)
    assert np.array_equal(restored, image), (image.shape, side)


@pytest.mark.parametrize("size", SIZES)
def test_numbers_are_the_references_and_give_the_image_back(size: tuple[int, int]) -> None:
    for side in SIDES:
        for image in (noise(*size), noise(*size, 3)):
            check(image, side, differences(image, side))


def test_parts_of_larger_images_are_read_and_filled_alone() -> None:
    large = noise(40, 50, 3)
    part = large[3:20, 10:31]
    assert np.array_equal(predict(part, 8), differences(part, 8))
    target = np.zeros((40, 50, 3), np.uint8)
    restore(predict(part, 8), 8, target[5:22, 20:41])
    assert np.array_equal(target[5:22, 20:41], part)
    target[5:22, 20:41] = 0
    assert not target.any()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: predict(noise(4, 4, 3).astype(np.float32), 8),
        lambda: predict(noise(4, 4, 3)[:, ::2], 8),
        lambda: predict(noise(4, 4, 2), 8),
        lambda: predict(noise(0, 4, 3), 8),
        lambda: predict(noise(4, 4, 3), 0),
        lambda: restore(np.zeros(47, np.uint8), 8, noise(4, 4, 3)),
        lambda: restore(np.zeros(48, np.int8), 8, noise(4, 4, 3)),
        lambda: restore(np.zeros(48, np.uint8), 8, np.frombuffer(bytes(48), np.uint8).reshape(4, 4, 3)),
    ],
)
def test_what_is_no_such_image_is_refused(wrong: Callable[[], object]) -> None:
    with pytest.raises(ValueError):
        wrong()
