"""Training images as steps compare with them: at half their size at first, and with their masks.

A quarter of the pixels shows where things are and how they move; details are learned afterwards. At equal time a
training that begins so ends sharper, and motion has a wider basin to be found in.

A scene of a subject alone has no background to learn. Over a colour that differs from step to step nothing but the
right alpha explains every image; over one colour, Gaussians of that colour would.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.masking import recolored
from ...frames.image_coding import halved_image
from ...frames.store import FrameStore

_LEAST_HALVED = 64  # pixels a side; smaller images are never reduced


def is_halved(camera: Camera, progress: float, until: float) -> bool:
    """True where ``camera`` is drawn at half its size at ``progress``, both fractions of the training."""
    return progress < until and min(camera.height, camera.width) >= _LEAST_HALVED


def halved(camera: Camera) -> Camera:
    """The same view with half the pixels a side, rounded down."""
    return camera.resized(camera.width // 2, camera.height // 2)


def sized(pixels: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 an image, or (H, W) a mask, as its camera or the halved one sees it."""
    return pixels if pixels.shape[:2] == (camera.height, camera.width) else halved_image(pixels)


Color = tuple[float, float, float]
Pixels = NDArray[np.uint8]
_LEAST_WEIGHT = 0.02
_GOLDEN = (0.8191725, 0.6710436, 0.5497005)  # steps of an even sequence in three dimensions (Roberts 2018)


@dataclass(frozen=True, eq=False)
class Truth:
    """An image, or a part of it, as a drawing of it should be.

    Attributes:
        pixels: (H, W, 3) uint8 over ``background``, black where they are ignored.
        background: colour in [0, 1] that belongs behind the drawing.
        alpha: (H, W) uint8, the subject's share; None where the image is whole.
        ignored: (H, W) bool, pixels that do not count; None where all do.
        empty_weight: of pixels outside the subject, at most 1: all together they weigh no more than the subject.
    """

    pixels: Pixels
    background: Color
    alpha: Pixels | None = None
    ignored: NDArray[np.bool_] | None = None
    empty_weight: float = 1.0

    @property
    def whole(self) -> NDArray[np.bool_] | None:
        """(H, W) pixels that are all subject and count; None where all are."""
        whole = None if self.alpha is None else self.alpha == 255
        if self.ignored is None:
            return whole
        return ~self.ignored if whole is None else whole & ~self.ignored


class Mattes:
    """The truth of a capture's images.

    Attributes:
        has_alpha, has_ignored: of any image.
    """

    def __init__(self, capture: Capture, store: FrameStore) -> None:
        self._capture, self._store = capture, store
        masked = capture.has_masks and bool(capture.shots)
        self._shares: dict[int, float] = {}  # of the subject, by shot
        self.has_alpha = masked and store.alpha(0) is not None
        self.has_ignored = masked and store.ignored(0) is not None

    def truth(
        self, shot: int, camera: Camera, region: tuple[int, int, int, int], background: Color | None = None
    ) -> Truth:
        """A region (left, top, width, height) of a shot's image.

        Args:
            camera: its camera, or the one of half the size.
            background: the colour that the image is to lie over; None for the capture's.
        """
        usual = self._capture.background
        pixels = self._store.part(shot, region, self._is_half(shot, camera))
        alpha = _part(self._store.alpha(shot), camera, region) if self.has_alpha else None
        ignored = _part(self._store.ignored(shot), camera, region) > 0 if self.has_ignored else None
        if ignored is not None and ignored.any():
            pixels = np.where(ignored[..., None], np.uint8(0), pixels)
        weight = self._empty_weight(shot)
        if alpha is None or background is None:
            return Truth(pixels, usual, alpha, ignored, weight)
        red, green, blue = (min(1.0, value * gain) for value, gain in zip(background, camera.exposure, strict=True))
        pixels = recolored(pixels, alpha, usual, (red, green, blue))
        if ignored is not None:
            pixels[ignored] = 0
        gain_red, gain_green, gain_blue = camera.exposure  # which the drawing, its background too, is exposed by
        return Truth(pixels, (red / gain_red, green / gain_green, blue / gain_blue), alpha, ignored, weight)

    def prefetch(self, shot: int, camera: Camera, region: tuple[int, int, int, int]) -> None:
        """Begins to read what ``truth`` will probably be asked for next."""
        self._store.prefetch(shot, region, self._is_half(shot, camera))

    def _is_half(self, shot: int, camera: Camera) -> bool:
        full = self._capture.cameras[self._capture.shots[shot].camera]
        return (camera.height, camera.width) != (full.height, full.width)

    def _empty_weight(self, shot: int) -> float:
        """See Truth, of all the image."""
        if not self.has_alpha:
            return 1.0
        if shot not in self._shares:
            alpha = self._store.alpha(shot)
            self._shares[shot] = 1.0 if alpha is None else float(alpha.mean()) / 255
        share = self._shares[shot]
        return min(1.0, max(_LEAST_WEIGHT, share / max(1 - share, _LEAST_WEIGHT)))

    def counted(self, shot: int) -> NDArray[np.bool_] | None:
        """(H, W) the pixels of a shot that count; None where all do."""
        ignored = self._store.ignored(shot) if self.has_ignored else None
        return None if ignored is None or not ignored.any() else ignored == 0

    def squared_error(self, shot: int, image: NDArray[np.float32]) -> float:
        """Mean squared error of a drawing (H, W, 3) over the capture's background, of the pixels that count."""
        error = (image - self._store.image(shot).astype(np.float32) / 255) ** 2
        counted = self.counted(shot)
        return float(np.mean(error if counted is None else error[counted]))

    def random_background(self, generator: torch.Generator) -> Color | None:
        """The colour of a step; None where images are whole, and nothing is drawn of ``generator``."""
        if not self.has_alpha:
            return None
        red, green, blue = torch.rand(3, generator=generator).tolist()
        return red, green, blue

    def background_of(self, position: int) -> Color:
        """The colour of the view of a number in a row of views that are measured on: the capture's where images are
        whole; otherwise they differ, so that nothing of the subject has the colour of all."""
        if not self.has_alpha:
            return self._capture.background
        red, green, blue = (math.fmod(0.5 + (position + 1) * step, 1.0) for step in _GOLDEN)
        return red, green, blue


def behind_ignored(
    ignored: NDArray[np.bool_], means: torch.Tensor, camera: Camera, region: tuple[int, int, int, int]
) -> torch.Tensor:
    """(N,) bool: Gaussians whose means (N, 3) ``camera`` sees in a pixel that is ignored.

    Args:
        ignored: (H, W) of the ``region`` (left, top, width, height) of the camera's image.
    """
    pose = torch.from_numpy(camera.world_to_camera[:3]).to(means)
    lens = torch.from_numpy(camera.intrinsics).to(means)
    placed = means @ pose[:, :3].T + pose[:, 3]
    left, top, width, height = region
    depths = placed[:, 2].clamp(min=torch.finfo(means.dtype).tiny)
    columns = (placed @ lens[0] / depths - left).floor()
    lines = (placed @ lens[1] / depths - top).floor()
    inside = (placed[:, 2] > 0) & (columns >= 0) & (lines >= 0) & (columns < width) & (lines < height)
    places = torch.where(inside, lines * width + columns, 0).long()
    return inside & torch.from_numpy(ignored).to(means.device).flatten()[places]


def _part(image: Pixels | None, camera: Camera, region: tuple[int, int, int, int]) -> Pixels:
    assert image is not None
    left, top, width, height = region
    return sized(image, camera)[top : top + height, left : left + width]
