"""Masks for people: in words, and one image of each camera in which what they leave out is tinted."""

import numpy as np

from ..arrays import ImageArray
from .capture import Capture, Shot
from .decoding import decode_masked
from .masking import over
from .seeding.views import spread

# Red where the subject is not, blue where pixels are ignored.
_OUTSIDE, _IGNORED = (0.9, 0.16, 0.16), (0.16, 0.35, 0.94)
_TINT = 0.6
_MOST = 48  # images; of more cameras, evenly spread ones


def marked(image: ImageArray, alpha: ImageArray | None, ignored: ImageArray | None) -> ImageArray:
    """An image (H, W, 3) uint8, tinted by how little ``alpha`` (H, W) it has, and where it is ``ignored`` (H, W)."""
    for mask, color in ((None if alpha is None else 255 - alpha, _OUTSIDE), (ignored, _IGNORED)):
        if mask is not None:
            image = over(image, (255 - _TINT * mask).astype(np.uint8), color)
    return image


def marked_image(capture: Capture, shot: int, longest_side: int) -> ImageArray:
    """The image of a shot at ``longest_side`` pixels a side at most, with its masks.

    Raises:
        FrogError: if a file cannot be decoded, or a mask does not fit.
    """
    camera = capture.cameras[capture.shots[shot].camera]
    small = capture.scaled(min(1.0, longest_side / max(camera.width, camera.height)))
    image = next(decode_masked(small.without_masks(), [shot])).image
    if not small.has_masks:
        return image
    masked = next(decode_masked(small, [shot]))
    return marked(image, masked.alpha, masked.ignored)


def first_shots(capture: Capture, most: int = _MOST) -> list[int]:
    """The first image of each camera, as indices into ``capture.shots``: of more than ``most``, evenly spread ones."""
    first = {shot.camera: index for index, shot in reversed([*enumerate(capture.shots)])}
    return spread([index for _, index in sorted(first.items())], most)


def mask_lines(capture: Capture) -> list[str]:
    """What the masks of a capture are, a line for each kind; none where its images are whole."""
    shots = capture.shots
    kinds = {
        "only this: masks of": [shot for shot in shots if shot.mask and not shot.mask.is_alpha],
        "only this: alpha of": [shot for shot in shots if shot.mask and shot.mask.is_alpha],
        "ignored: masks of": [shot for shot in shots if shot.ignore],
    }
    lines = [f"{text} {_counted(masked)}" for text, masked in kinds.items() if masked]
    return [*lines, f"only this: what is not {capture.key}"] if capture.key else lines


def _counted(shots: list[Shot]) -> str:
    """``12 cameras, 30 frames each``."""
    cameras = len({shot.camera for shot in shots})
    if cameras == len(shots):
        return f"{len(shots)} images"
    of_camera = len(shots) / cameras
    frames = f"{of_camera:g} frames each" if of_camera.is_integer() else f"{len(shots)} images in all"
    return f"{cameras} camera{'s' if cameras > 1 else ''}, {frames}"
