"""Half-size images at the start of a training."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import odd_camera
from support.training_steps import train

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.training.optimize import canonical_sampling
from frog_blender.engine.training.optimize.half_resolution import (
    halved,
    halved_capture,
    halved_image,
    is_halved,
    sized,
)
from frog_blender.engine.training.optimize.trainer import Trainer


def test_a_halved_camera_sees_the_same_at_half_the_pixels() -> None:
    camera = odd_camera(160, 96)
    points = camera.unproject(np.random.default_rng(0).uniform(0, [160, 96], (20, 2)), np.full(20, 3.0))
    np.testing.assert_allclose(halved(camera).project(points)[0], camera.project(points)[0] / 2, atol=1e-9)


@pytest.mark.parametrize("size", [(64, 96), (65, 97)])
def test_a_halved_image_has_the_means_and_the_size_of_the_camera(size: tuple[int, int]) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    found = halved_image(pixels)
    camera = halved(odd_camera(size[1], size[0]))
    assert found.shape == (camera.height, camera.width, 3) and found.dtype == np.uint8
    assert found.mean() == pytest.approx(pixels.mean(), abs=1)
    if size == (64, 96):
        means = pixels.reshape(32, 2, 48, 2, 3).mean((1, 3))
        assert np.abs(found - means).max() <= 0.5


def test_small_images_stay_as_they_are() -> None:
    assert is_halved(odd_camera(64, 80), 0.1, 0.4)
    assert not is_halved(odd_camera(63, 80), 0.1, 0.4)
    assert not is_halved(odd_camera(64, 80), 0.4, 0.4)
    assert not is_halved(odd_camera(64, 80), 0.0, 0.0)


def test_a_halved_capture_has_images_that_fit(filmed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = open_capture(filmed)
    width, height = capture.cameras[0].width, capture.cameras[0].height
    pixels = np.random.default_rng(2).integers(0, 256, (height, width, 3)).astype(np.uint8)
    monkeypatch.setattr("frog_blender.engine.training.optimize.half_resolution._LEAST", min(width, height) + 1)
    (kept, *_) = halved_capture(capture).cameras
    assert kept is capture.cameras[0] and sized(pixels, kept) is pixels
    monkeypatch.setattr("frog_blender.engine.training.optimize.half_resolution._LEAST", min(width, height))
    small = halved_capture(capture)
    assert small.shots == capture.shots and small.cameras[0].width == width // 2
    np.testing.assert_array_equal(sized(pixels, small.cameras[0]), halved_image(pixels))


def test_a_training_begins_at_half_size_and_ends_at_whole(
    make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frog_blender.engine.training.optimize.half_resolution._LEAST", 16)
    trainer = make_trainer(60, half_size_until=0.5, sampling_until=0.95, densify_until=0.0, max_gaussians=5000)
    sizes: list[tuple[float, tuple[int, int]]] = []
    draw, place = trainer.model.draw, canonical_sampling.worst_points
    anchored: list[tuple[int, int]] = []

    def watched(time: float, camera: Any, *others: Any) -> Any:
        sizes.append((trainer.progress, (camera.width, camera.height)))
        return draw(time, camera, *others)

    def placed(image: Any, truth: Any, camera: Any, *others: Any) -> Any:
        assert truth.shape == image.rgb.shape == (camera.height, camera.width, 3)
        anchored.append((camera.width, camera.height))
        return place(image, truth, camera, *others)

    monkeypatch.setattr(trainer.model, "draw", watched)
    monkeypatch.setattr(canonical_sampling, "worst_points", placed)
    train(trainer)
    whole = (trainer.capture.cameras[0].width, trainer.capture.cameras[0].height)
    half = (whole[0] // 2, whole[1] // 2)
    assert {size for progress, size in sizes if progress < 0.5} == {half}
    assert {size for progress, size in sizes if progress > 0.52} == {whole}
    assert set(anchored) == {half, whole}
