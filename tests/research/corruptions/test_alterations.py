"""Corrupted images: deterministic, and never held-out ones unless the whole scene is different."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.research.corruptions.alterations import (
    Compression,
    Exposure,
    Light,
    Noise,
    Occlusion,
    brightened_values,
)

GREY = np.full((60, 80, 3), 128, np.uint8)
ALL = [Exposure(0.3), Light(0.25), Noise(8), Compression(30), Occlusion(0.4, 10)]


@pytest.mark.parametrize("alteration", ALL, ids=lambda item: type(item).__name__)
def test_the_same_image_always_comes_out_the_same(alteration: Noise) -> None:
    before = GREY.copy()
    images = [alteration.apply(GREY, "cam01", 4) for _ in range(2)]
    assert np.array_equal(*images)
    assert (images[0].shape, images[0].dtype) == (GREY.shape, np.uint8)
    assert np.array_equal(GREY, before), "the decoded image is not written to"


def test_exposure_is_a_cameras_own_and_stays() -> None:
    levels = {
        name: {int(Exposure(0.3).apply(GREY, name, frame)[0, 0, 0]) for frame in range(5)} for name in ("a", "b", "c")
    }
    assert all(len(seen) == 1 for seen in levels.values())
    assert len(set.union(*levels.values())) == 3


def test_exposures_spread_as_asked() -> None:
    random = np.linspace(0.2, 0.6, 32, dtype=np.float32).reshape(4, 8, 1).repeat(3, 2)
    gains = []
    for k in range(300):
        altered = Exposure(0.2).apply((255 * random).astype(np.uint8), f"cam{k}", 0)
        light, before = (np.mean(((value / 255 + 0.055) / 1.055) ** 2.4) for value in (altered, (255 * random) // 1))
        gains.append(np.log2(light / before))
    assert np.std(gains) == pytest.approx(0.2, rel=0.1)
    assert np.mean(gains) == pytest.approx(0, abs=0.04)


def test_noise_is_as_strong_as_asked_and_new_in_every_image() -> None:
    first, second = (Noise(8).apply(GREY, "cam01", frame).astype(float) - 128 for frame in (0, 1))
    assert first.std() == pytest.approx(8, rel=0.05)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.05


def test_compression_loses_more_at_a_lower_quality() -> None:
    image = np.random.default_rng(0).integers(0, 255, GREY.shape).astype(np.uint8)
    errors = [np.abs(Compression(quality).apply(image, "cam", 0) - image.astype(int)).mean() for quality in (90, 20)]
    assert 0 < errors[0] < errors[1]


def test_someone_stands_before_a_camera_in_the_share_of_its_images() -> None:
    hidden = [not np.array_equal(Occlusion(0.3, 50).apply(GREY, "cam", frame), GREY) for frame in range(50)]
    assert sum(hidden) == pytest.approx(15, abs=1)
    frame = hidden.index(True)
    share = (Occlusion(0.3, 50).apply(GREY, "cam", frame) != GREY).any(axis=2).mean()
    assert share < 0.2


def test_brightening_takes_the_dark_back() -> None:
    dark = Light(0.25).apply(GREY, "cam", 0)
    assert int(dark[0, 0, 0]) < 70
    assert brightened_values(dark / 255, 4.0)[0, 0, 0] == pytest.approx(128 / 255, abs=0.01)


@pytest.mark.parametrize(("alteration", "tests_too"), [(Noise(20), False), (Light(0.25), True)])
def test_images_that_judge_change_only_with_the_whole_scene(
    filmed: Path, cache_folder: Path, alteration: Noise, tests_too: bool
) -> None:
    clean = open_capture(filmed)
    capture = replace(clean, alteration=alteration)
    before, after = (FrameStore.open(item, cache_folder=cache_folder) for item in (clean, capture))
    assert before.folder != after.folder
    changed = [not np.array_equal(before.image(i), after.image(i)) for i in range(len(before))]
    assert changed == [tests_too or not capture.is_test(shot) for shot in capture.shots]
