"""Half-size images at the start of a training."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import odd_camera
from support.training_steps import train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.frames.image_coding import halved_image
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.training.optimize.mattes import (
    halved,
    is_halved,
    sized,
)
from frog_blender.engine.training.optimize.trainer import Trainer


@pytest.mark.parametrize("size", [(64, 96), (65, 97)])
def test_a_halved_image_has_the_means_and_the_size_of_the_camera(size: tuple[int, int]) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    found = halved_image(pixels)
    camera = halved(odd_camera(size[1], size[0]))
    assert found.shape == (camera.height, camera.width, 3) and found.dtype == np.uint8
    assert found.mean() == pytest.approx(pixels.mean(), abs=1)
    whole = odd_camera(size[1], size[0])
    assert sized(pixels, whole) is pixels
    np.testing.assert_array_equal(sized(pixels, camera), found)
    assert not is_halved(odd_camera(48, 36), 0.0, 0.5), "fewer than 64 pixels a side"
    if size == (64, 96):
        means = pixels.reshape(32, 2, 48, 2, 3).mean((1, 3))
        assert np.abs(found - means).max() <= 0.5


class Watched(Trainer):
    """Remembers the sizes of what is drawn for steps, by progress, and of what shows where anchors are needed."""

    sizes: list[tuple[float, tuple[int, int]]]
    anchored: list[tuple[int, int]]

    def draw(self, shot_index: int, progress: float, options: RasterizeOptions, *more: Any) -> Any:
        truth, drawn = super().draw(shot_index, progress, options, *more)
        height, width, _ = drawn.image.rgb.shape
        assert truth.pixels.shape == (height, width, 3)
        if options.depth:
            camera = self.camera_at(self.capture.shots[shot_index].camera, progress)
            assert (camera.width, camera.height) == (width, height)
            self.anchored.append((width, height))
        elif progress >= self.recipe.warm_up:
            self.sizes.append((progress, (width, height)))
        return truth, drawn


def test_a_training_begins_at_half_size_and_ends_at_whole(
    capture: Capture, cache_folder: Path, lively: Callable[..., Recipe]
) -> None:
    large = capture.scaled(2.0)
    changes = {"half_size_until": 0.5, "sampling_until": 0.95, "densify_until": 0.0, "region_share": 0.0}
    recipe = lively(60, **{**changes, "max_gaussians": 5000})
    store = FrameStore.open(large, cache_folder=cache_folder)
    trainer = Watched(large, store, film.seeds(), recipe, JobOptions(steps=60))
    trainer.sizes, trainer.anchored = [], []
    train(trainer)
    whole = (large.cameras[0].width, large.cameras[0].height)
    half = (whole[0] // 2, whole[1] // 2)
    assert {size for progress, size in trainer.sizes if progress < 0.5} == {half}
    assert {size for progress, size in trainer.sizes if progress > 0.52} == {whole}
    assert set(trainer.anchored) == {half, whole}
