"""Corruptions of images: exposure, light, noise, compression, occlusion.

Each is a ``capture.Alteration``: it is deterministic, so that the same image always gets the same corruption.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from ...engine import Floats, ImageArray, linear_to_srgb, load_opencv, srgb_to_linear


class _Alteration:
    """The key and the random numbers that all corruptions share."""

    tests_too = False

    @property
    def key(self) -> str:
        return repr(self)

    def _random(self, camera: str, frame: int = -1) -> np.random.Generator:
        """Random numbers of one camera, or of one of its images."""
        return np.random.default_rng([zlib.crc32(repr(self).encode()), zlib.crc32(camera.encode()), frame + 1])


@dataclass(frozen=True)
class Exposure(_Alteration):
    """Each camera has its own constant exposure, with a standard deviation of ``stops``."""

    stops: float

    def apply(self, image: ImageArray, camera: str, frame: int) -> ImageArray:
        return brightened(image, 2 ** self._random(camera).normal(0, self.stops))


@dataclass(frozen=True)
class Light(_Alteration):
    """``gain`` times the light, in the held-out images as well."""

    gain: float
    tests_too = True

    def apply(self, image: ImageArray, camera: str, frame: int) -> ImageArray:
        return brightened(image, self.gain)


@dataclass(frozen=True)
class Noise(_Alteration):
    """Gaussian noise in every pixel and channel, with a standard deviation of ``deviation`` of 255."""

    deviation: float

    def apply(self, image: ImageArray, camera: str, frame: int) -> ImageArray:
        noise = self._random(camera, frame).normal(0, self.deviation, image.shape)
        return (image + noise).round().clip(0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Compression(_Alteration):
    """JPEG of this ``quality`` (1 to 100), chroma at half the resolution."""

    quality: int

    def apply(self, image: ImageArray, camera: str, frame: int) -> ImageArray:
        cv2 = load_opencv()
        _, data = cv2.imencode(".jpg", image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        decoded: ImageArray = cv2.imdecode(data, cv2.IMREAD_COLOR)
        return np.ascontiguousarray(decoded[:, :, ::-1])


@dataclass(frozen=True)
class Occlusion(_Alteration):
    """A grey figure, half an image high, walks past each camera at its own time, in ``share`` of the ``frames``."""

    share: float
    frames: int

    def apply(self, image: ImageArray, camera: str, frame: int) -> ImageArray:
        random = self._random(camera)
        begin, grey = random.random() * self.frames, random.integers(40, 120)
        passed = ((frame - begin) % self.frames) / (self.share * self.frames)
        if passed >= 1:
            return image
        height, width = image.shape[:2]
        center = (round(passed * width), round(0.6 * height))
        size = (round(0.11 * height), round(0.27 * height))
        occluded: ImageArray = load_opencv().ellipse(image.copy(), center, size, 0, 0, 360, (int(grey),) * 3, -1)
        return occluded


def brightened(image: ImageArray, gain: float) -> ImageArray:
    """An sRGB image (H, W, 3) with ``gain`` times the light, clipped as its camera would."""
    table: ImageArray = (255 * brightened_values(np.arange(256) / 255, gain)).round().astype(np.uint8)
    return table[image]


def brightened_values(values: Floats, gain: float) -> Floats:
    """sRGB values in [0, 1], of any shape, with ``gain`` times the light, clipped to [0, 1]."""
    return linear_to_srgb((srgb_to_linear(values) * gain).clip(0, 1))
