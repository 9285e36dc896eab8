"""What happens to images on their way into a capture: exposure, light, noise, compression, things in the way.

Each alteration is a ``capture.Alteration``: the same image always comes out the same, whoever asks.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from ...engine.capture.video import load_opencv
from ...engine.srgb import linear_to_srgb, srgb_to_linear


class _Alteration:
    """What all share: the key names everything that decides the result."""

    tests_too = False

    @property
    def key(self) -> str:
        return repr(self)

    def _random(self, camera: str, frame: int = -1) -> np.random.Generator:
        """Of one camera, or of one of its images."""
        return np.random.default_rng([zlib.crc32(repr(self).encode()), zlib.crc32(camera.encode()), frame + 1])


@dataclass(frozen=True)
class Exposure(_Alteration):
    """Every camera is exposed differently: by ``stops`` in standard deviation, all its film long."""

    stops: float

    def apply(self, image: np.ndarray, camera: str, frame: int) -> np.ndarray:
        return brightened(image, 2 ** self._random(camera).normal(0, self.stops))


@dataclass(frozen=True)
class Light(_Alteration):
    """The lamps give ``gain`` times the light; the images that judge are as dark."""

    gain: float
    tests_too = True

    def apply(self, image: np.ndarray, camera: str, frame: int) -> np.ndarray:
        return brightened(image, self.gain)


@dataclass(frozen=True)
class Noise(_Alteration):
    """Normal noise in every pixel and channel, ``deviation`` of 255."""

    deviation: float

    def apply(self, image: np.ndarray, camera: str, frame: int) -> np.ndarray:
        noise = self._random(camera, frame).normal(0, self.deviation, image.shape)
        return (image + noise).round().clip(0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Compression(_Alteration):
    """JPEG of this ``quality`` (1 to 100), colours at half the resolution."""

    quality: int

    def apply(self, image: np.ndarray, camera: str, frame: int) -> np.ndarray:
        cv2 = load_opencv()
        _, data = cv2.imencode(".jpg", image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[:, :, ::-1])


@dataclass(frozen=True)
class Occlusion(_Alteration):
    """Somebody walks close past every camera, each at a time and pace of their own: a grey figure, half an image
    high, stands in ``share`` of the images."""

    share: float
    frames: int

    def apply(self, image: np.ndarray, camera: str, frame: int) -> np.ndarray:
        random = self._random(camera)
        begin, grey = random.random() * self.frames, random.integers(40, 120)
        passed = ((frame - begin) % self.frames) / (self.share * self.frames)
        if passed >= 1:
            return image
        height, width = image.shape[:2]
        center = (round(passed * width), round(0.6 * height))
        size = (round(0.11 * height), round(0.27 * height))
        return load_opencv().ellipse(image.copy(), center, size, 0, 0, 360, (int(grey),) * 3, -1)


def brightened(image: np.ndarray, gain: float) -> np.ndarray:
    """An sRGB image, uint8 or in [0, 1], with ``gain`` times the light, as its camera would clip it."""
    if image.dtype == np.uint8:
        table = 255 * _clipped_srgb(srgb_to_linear(np.arange(256) / 255) * gain)
        return table.round().astype(np.uint8)[image]
    return _clipped_srgb(srgb_to_linear(image) * gain)


def _clipped_srgb(value: np.ndarray) -> np.ndarray:
    return linear_to_srgb(value.clip(0, 1))
