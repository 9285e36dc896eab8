"""Which pixels count as moving: found in the images of a fixed camera, or read from a file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..capture.capture import Capture
from ..capture.video import image_size, read_gray
from ..errors import found_instead
from ..frames.store import FrameStore
from ..io.numpy_files import read_npz
from ..io.regular_file import regular_file

Mask = NDArray[np.bool_]

_EXPECTED = "an image or an .npz of masks"
_MORE_FRAMES = 1000  # masks may cover a whole video of which the capture is a part
_MOVING_DEVIATION = 6 / 255  # temporal standard deviation above which a pixel counts as moving


def moving_mask(store: FrameStore, shot_indices: Sequence[int]) -> Mask:
    """(H, W) mask of the pixels of one fixed camera that change over time.

    A pixel counts where its temporal standard deviation, in the channel where that is largest, exceeds 6/255.

    Args:
        shot_indices: the camera's images, indices into ``Capture.shots``.
    """
    total = square = np.zeros(())
    for index in shot_indices:
        image = store.image(index).astype(np.float64) / 255
        total = total + image
        square = square + image**2
    count = len(shot_indices)
    variance = square / count - (total / count) ** 2
    return np.asarray(np.sqrt(np.maximum(variance, 0).max(axis=2)) > _MOVING_DEVIATION)


def load_masks(path: Path, capture: Capture) -> dict[str, Mask]:
    """Masks by camera name, each (H, W) or (frames, H, W).

    Args:
        path: an image, whose white pixels count in all cameras, or an ``.npz`` with an array for each camera.

    Raises:
        FrogError: if the file cannot be read, or a name or a size does not fit the capture.
    """
    regular_file(path, _EXPECTED)
    names = {camera.name: (camera.height, camera.width) for camera in capture.cameras}

    def check(name: str, shape: tuple[int, ...]) -> None:
        if name not in names:
            shown = ", ".join([*list(names)[:12], "..."] if len(names) > 12 else names)
            raise found_instead(path, f"a mask named {name!r}", f"names of cameras: {shown}")
        height, width = names[name]
        if shape[-2:] != names[name] or len(shape) not in (2, 3) or not shape[0]:
            raise found_instead(path, f"a mask of {shape}", f"{height} x {width} for {name}")

    if path.suffix.lower() == ".npz":
        pixels = sum(height * width for height, width in names.values())
        masks = read_npz(path, _EXPECTED, (capture.frame_count + _MORE_FRAMES) * pixels, check)
        return {name: mask > 0 for name, mask in masks.items()}
    size = image_size(path)
    for name in names:
        check(name, size[::-1])
    return dict.fromkeys(names, read_gray(path) > 127)
