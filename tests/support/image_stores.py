"""Stores of images that were made in memory, in place of a FrameStore."""

import numpy as np

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
