"""Which pixels of a capture count: subject masks ("only this"), masks of what is ignored, and chroma keys."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Float32s, ImageArray
from ..errors import FrogError, brief

_NAMED = {"green": (0, 177, 64), "blue": (0, 71, 187)}  # the paints of film stages
_HEX = re.compile(r"#?([0-9a-fA-F]{6})")
_LEAST_CHROMA = 0.08  # of the display range: with less a colour has no hue to be told by
_TOLERANCE = 0.4
# Of a colour in [0, 1], without its brightness (BT.709's Cb and Cr).
_CHROMA = np.array([[-0.1146, -0.3854, 0.5], [0.5, -0.4542, -0.0458]], np.float32)
_CLEAN = 0.04  # share of the key colour below which a pixel is all subject: noise of the camera


@dataclass(frozen=True)
class MaskSource:
    """Where the mask of one image lies.

    Attributes:
        path: an image or a video.
        index: frame within the video, 0 for an image.
        is_alpha: the mask is the image's alpha channel; else its brightness, white for what is meant.
        inverted: black is what is meant.
    """

    path: Path
    index: int = 0
    is_alpha: bool = False
    inverted: bool = False


@dataclass(frozen=True)
class ChromaKey:
    """The colour of a stage's backdrop, which is not part of the subject.

    Attributes:
        color: red, green and blue, 0 to 255.
        tolerance: 0 to 1, how much less of the colour than its own a pixel of the backdrop may have: in shadows, say.
    """

    color: tuple[int, int, int]
    tolerance: float = _TOLERANCE

    def __str__(self) -> str:
        return f"#{bytes(self.color).hex()},{self.tolerance:g}"

    def apply(self, image: ImageArray) -> tuple[ImageArray, ImageArray]:
        """An image's subject over black, (H, W, 3) uint8, and its alpha (H, W) uint8.

        A pixel is a share of the key colour and the rest of the subject, whose hue is another: what it has of the key's
        is taken off, at soft edges and where the backdrop shines onto the subject.

        Args:
            image: (H, W, 3) uint8.
        """
        color = np.array(self.color, np.float32) / 255
        hue = _CHROMA @ color
        strength = float(np.linalg.norm(hue))
        hue /= strength
        pixels: Float32s = image.astype(np.float32) / 255
        chroma = pixels @ _CHROMA.T
        along = chroma @ hue
        across = np.abs(chroma @ np.array([-hue[1], hue[0]], np.float32))
        share = ((along - across) / strength).clip(0, 1)
        share[share < _CLEAN] = 0
        spill = np.where(share > 0, along / strength, 0).clip(0, 1)
        alpha: Float32s = (1 - share / max(1 - self.tolerance, 0.01)).clip(0, 1)
        subject: Float32s = np.clip(pixels - spill[..., None] * color, 0, alpha[..., None]).astype(np.float32)
        return _bytes(subject), _bytes(alpha)


def chroma_key(text: str) -> ChromaKey:
    """The key that ``COLOUR[,TOLERANCE]`` says: ``green``, ``blue`` or ``#00b140``, and a number from 0 to 0.95.

    Raises:
        FrogError: for other text, or a colour without a hue.
    """
    name, _, rest = text.partition(",")
    name = name.strip().lower()
    digits = _HEX.fullmatch(name)
    color = _NAMED.get(name) or (tuple(bytes.fromhex(digits[1])) if digits else None)
    try:
        tolerance = float(rest) if rest.strip() else _TOLERANCE
    except ValueError:
        tolerance = math.nan
    if color is None or not 0 <= tolerance <= 0.95:
        raise FrogError(
            f"The key is {brief(repr(text))}, expected green, blue or a colour such as #00b140, and after a comma a "
            "tolerance from 0 to 0.95."
        )
    red, green, blue = color
    if np.linalg.norm(_CHROMA @ (np.array(color, np.float32) / 255)) < _LEAST_CHROMA:
        raise FrogError(f"The key colour {name} is grey, expected one with a hue, such as green.")
    return ChromaKey((red, green, blue), tolerance)


@dataclass(frozen=True)
class MaskSettings:
    """What is made of a capture's masks.

    Attributes:
        use: whether masks and alpha count; False trains on whole images.
        key: a ``chroma_key`` of all images, or None.
    """

    use: bool = True
    key: str | None = None


EVERY_MASK = MaskSettings()
"""What there is counts, and nothing is keyed."""


def over(image: ImageArray, alpha: ImageArray, background: tuple[float, float, float]) -> ImageArray:
    """(H, W, 3) uint8 the pixels (H, W, 3) under a mask (H, W) over a colour in [0, 1]."""
    share: Float32s = alpha.astype(np.float32)[..., None] / 255
    composed: Float32s = image.astype(np.float32) / 255 * share + np.asarray(background, np.float32) * (1 - share)
    return _bytes(composed)


def recolored(
    image: ImageArray, alpha: ImageArray, before: tuple[float, float, float], background: tuple[float, float, float]
) -> ImageArray:
    """(H, W, 3) uint8 an image that lies over the colour ``before``, over another one instead; colours in [0, 1]."""
    change = np.asarray(background, np.float32) - np.asarray(before, np.float32)
    moved = change * (255 - alpha.astype(np.float32))[..., None]
    return np.asarray((image + moved + 0.5).clip(0, 255).astype(np.uint8))


def _bytes(values: Float32s) -> ImageArray:
    return np.asarray((values * 255 + 0.5).astype(np.uint8))
