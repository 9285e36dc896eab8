"""Masks for people: in words, and a sheet of one image of each camera in which what they leave out is tinted."""

import math
from pathlib import Path

import numpy as np

from ..arrays import ImageArray
from ..errors import found_instead
from .capture import Capture, Shot
from .decoding import decode_masked
from .masking import over
from .seeding.views import spread
from .video import load_opencv, write_image

SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of files that a sheet can be written to."""
# Red where the subject is not, blue where pixels are ignored.
_OUTSIDE, _IGNORED = (0.9, 0.16, 0.16), (0.16, 0.35, 0.94)
_TINT = 0.6
_SIDE = 320  # pixels of an image
_MOST = 48  # images; of more cameras, evenly spread ones
_LABEL, _GAP = 22, 4  # pixels


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


def contact_sheet(capture: Capture) -> ImageArray:
    """(H, W, 3) uint8 one image of each camera with its masks and its name; errors as of ``marked_image``."""
    cv2 = load_opencv()
    shots = first_shots(capture)
    images = [marked_image(capture, shot, _SIDE) for shot in shots]
    columns = math.ceil(math.sqrt(len(images)))
    height, width = (max(image.shape[axis] for image in images) for axis in (0, 1))
    down, across = height + _LABEL + _GAP, width + _GAP
    sheet = np.full((-(-len(images) // columns) * down, columns * across, 3), 24, np.uint8)
    for index, (shot, image) in enumerate(zip(shots, images, strict=True)):
        top, left = index // columns * down, index % columns * across
        sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
        name = capture.cameras[capture.shots[shot].camera].name
        corner = (left + _GAP, top + height + _LABEL - 7)
        cv2.putText(sheet, name, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (230, 230, 230), 1, cv2.LINE_AA)
    return sheet


def write_contact_sheet(capture: Capture, path: Path) -> None:
    """Writes ``contact_sheet`` as PNG or JPEG.

    Raises:
        FrogError: for another ending, a file that cannot be decoded, or a place that cannot be written to.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise found_instead(path, f"the ending {path.suffix!r}", f"one of {', '.join(SUFFIXES)}")
    write_image(path, contact_sheet(capture))


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
