"""Training images as steps compare with them: at half their size at first, and with their masks.

A quarter of the pixels shows where things are and how they move; details are learned afterwards. At equal time a
training that begins so ends sharper, and motion has a wider basin to be found in.

A scene of a subject alone has no background to learn. Over a colour that differs from step to step nothing but the
right alpha explains every image; over one colour, Gaussians of that colour would.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...arrays import ImageArray
from ...capture.camera import Camera
from ...capture.capture import Capture
from ...cuda import launch
from ...evaluation.metrics import psnr_of
from ...frames.image_coding import Region, halved_image
from ...frames.store import FrameStore
from .transfers import KeptImages

_LEAST_HALVED = 64  # pixels a side; smaller images are never reduced


def is_halved(camera: Camera, progress: float, until: float) -> bool:
    """True where ``camera`` is drawn at half its size at ``progress``, both fractions of the training."""
    return progress < until and min(camera.height, camera.width) >= _LEAST_HALVED


def halved(camera: Camera) -> Camera:
    """The same view with half the pixels a side, rounded down."""
    return camera.resized(camera.width // 2, camera.height // 2)


def sized(pixels: ImageArray, camera: Camera) -> ImageArray:
    """(H, W, 3) uint8 an image, or (H, W) a mask, as its camera or the halved one sees it."""
    return pixels if pixels.shape[:2] == (camera.height, camera.width) else halved_image(pixels)


Color = tuple[float, float, float]
_IMAGE = "image"
_LEAST_WEIGHT = 0.02
_GOLDEN = (0.8191725, 0.6710436, 0.5497005)  # steps of an even sequence in three dimensions (Roberts 2018)


@dataclass(frozen=True, eq=False)
class Truth:
    """An image, or a part of it, as a drawing of it should be; on the training's device, and not to be written to.

    Attributes:
        pixels: (H, W, 3) uint8 over ``background``, black where they are ignored; may be a view of a larger image.
        background: colour in [0, 1] that belongs behind the drawing.
        alpha: (H, W) uint8, the subject's share, such a view; None where the image is whole.
        ignored: (H, W) bool, pixels that do not count; None where all do, which on a GPU is not looked for.
        empty_weight: of pixels outside the subject, at most 1: all together they weigh no more than the subject.
    """

    pixels: torch.Tensor
    background: Color
    alpha: torch.Tensor | None = None
    ignored: torch.Tensor | None = None
    empty_weight: float = 1.0

    @property
    def colors(self) -> torch.Tensor:
        """(H, W, 3) float32 in [0, 1]."""
        return self.pixels.float() / 255

    def psnr(self, rgb: torch.Tensor) -> float:
        """Of a drawing (H, W, 3), in dB, of the pixels that count, where any do."""
        square = (rgb.clamp(0, 1) - self.colors).square()
        if self.ignored is not None and not self.ignored.all():
            square = square[~self.ignored]
        return psnr_of(float(square.mean()))

    @property
    def whole(self) -> torch.Tensor | None:
        """(H, W) pixels that are all subject and count; None where all are."""
        whole = None if self.alpha is None else self.alpha == 255
        if self.ignored is None:
            return whole
        return ~self.ignored if whole is None else whole & ~self.ignored


class Mattes:
    """The truth of a capture's images.

    Args:
        images: what is kept of them where a training computes; nothing, on the CPU.

    Attributes:
        has_alpha, has_ignored: of any image.
    """

    def __init__(self, capture: Capture, store: FrameStore, images: KeptImages | None = None) -> None:
        self._capture, self._store, self._images = capture, store, images or KeptImages(torch.device("cpu"))
        masked = capture.has_masks and bool(capture.shots)
        self._shares: dict[int, float] = {}  # of the subject, by shot
        self.has_alpha = masked and store.alpha(0) is not None
        self.has_ignored = masked and store.ignored(0) is not None

    def truth(self, shot: int, camera: Camera, region: Region | None = None, background: Color | None = None) -> Truth:
        """A region (left, top, width, height) of a shot's image, or all of it.

        Args:
            camera: its camera, or the one of half the size.
            background: the colour that the image is to lie over; None for the capture's.
        """
        usual, half = self._capture.background, self._is_half(shot, camera)
        region = region or (0, 0, camera.width, camera.height)

        def part(name: str, read: Callable[[Region], ImageArray]) -> torch.Tensor:
            return self._images.part((name, shot, half), camera, region, read)

        pixels, alpha, ignored = part(_IMAGE, lambda which: self._store.part(shot, which, half)), None, None
        if self.has_alpha:
            alpha = part("alpha", lambda which: _part(self._store.alpha(shot), camera, which))
        if self.has_ignored:
            ignored = part("ignored", lambda which: _part(self._store.ignored(shot), camera, which)) > 0
            if not launch.on_gpu(ignored) and not ignored.any():  # nobody waits for a GPU's answer
                ignored = None
        if alpha is not None and background is not None:
            red, green, blue = (min(1.0, value * gain) for value, gain in zip(background, camera.exposure, strict=True))
            change = torch.tensor((red, green, blue), device="cpu") - torch.tensor(usual, device="cpu")
            moved = launch.sent(change, alpha.device) * (255 - alpha.float())[..., None]
            pixels = (pixels + moved + 0.5).clamp(0, 255).to(torch.uint8)  # as capture.masking.recolored
            # Which the drawing, its background too, is exposed by.
            gain_red, gain_green, gain_blue = camera.exposure
            usual = red / gain_red, green / gain_green, blue / gain_blue
        if ignored is not None:
            pixels = pixels.masked_fill(ignored[..., None], 0)
        return Truth(pixels, usual, alpha, ignored, self._empty_weight(shot))

    def prefetch(self, shot: int, camera: Camera, region: Region) -> None:
        """Begins to read what ``truth`` will probably be asked for next."""
        half = self._is_half(shot, camera)
        missing = self._images.missing((_IMAGE, shot, half), camera, region)
        if missing is not None:
            self._store.prefetch(shot, missing, half)

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


def behind_ignored(ignored: torch.Tensor, means: torch.Tensor, camera: Camera, region: Region) -> torch.Tensor:
    """(N,) bool: Gaussians whose means (N, 3) ``camera`` sees in a pixel that is ignored; see ``sampled``."""
    there, seen = sampled(ignored, means, camera, region)
    return there & seen


def sampled(
    mask: torch.Tensor, means: torch.Tensor, camera: Camera, region: Region
) -> tuple[torch.Tensor, torch.Tensor]:
    """Values (N,) of a mask where ``camera`` sees means (N, 3), and whether (N,) it sees them in it at all.

    Args:
        mask: (H, W) of the ``region`` (left, top, width, height) of the camera's image.
    """
    pose = launch.sent(torch.from_numpy(camera.world_to_camera[:3]).to(means.dtype), means.device)
    lens = launch.sent(torch.from_numpy(camera.intrinsics).to(means.dtype), means.device)
    placed = means @ pose[:, :3].T + pose[:, 3]
    left, top, width, height = region
    depths = placed[:, 2].clamp(min=torch.finfo(means.dtype).tiny)
    columns = (placed @ lens[0] / depths - left).floor()
    lines = (placed @ lens[1] / depths - top).floor()
    inside = (placed[:, 2] > 0) & (columns >= 0) & (lines >= 0) & (columns < width) & (lines < height)
    places = torch.where(inside, lines * width + columns, 0).long()
    return mask.flatten()[places], inside


def _part(image: ImageArray | None, camera: Camera, region: Region) -> ImageArray:
    assert image is not None
    left, top, width, height = region
    return sized(image, camera)[top : top + height, left : left + width]
