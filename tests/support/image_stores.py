"""Stores of images that were made in memory, in place of a FrameStore."""

import numpy as np
from support import synthetic_capture

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.frames.image_coding import halved_image


class ImageStore:
    """A store whose ``image`` says all: parts of it and reduced images are made of that."""

    is_large = False

    def image(self, shot_index: int) -> np.ndarray:
        raise NotImplementedError

    def part(self, shot_index: int, region: tuple[int, int, int, int], is_half: bool = False) -> np.ndarray:
        image, (left, top, width, height) = self.image(shot_index), region
        return (halved_image(image) if is_half else image)[top : top + height, left : left + width]

    def prefetch(self, shot_index: int, region: tuple[int, int, int, int], is_half: bool = False) -> None:
        """Nothing is to be read."""


class Drawn(ImageStore):
    """Images of the filmed capture as they were drawn, without a film's losses."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture

    def image(self, shot_index: int) -> np.ndarray:
        shot = self._capture.shots[shot_index]
        return synthetic_capture.image(self._capture.cameras[shot.camera], shot.frame)
