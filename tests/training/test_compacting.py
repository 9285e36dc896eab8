"""A finished scene in the order of its file shows what it showed, and says what of it cannot be seen when."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import ATTRIBUTES, odd_camera, scene_file
from playing import assert_same_bits, flickering, without_lifetimes

from frog_blender.engine.files import SceneFile, read_scene, write_scene
from frog_blender.engine.inference.draw import draw
from frog_blender.engine.inference.lifetimes import share_deformed
from frog_blender.engine.inference.scene import PlayableScene
from frog_blender.engine.model.on_device import SceneOnDevice
from frog_blender.engine.training.compacting import arranged, as_packed

TIMES = (0.0, 1 / 6, 0.3, 0.5, 0.77, 5 / 6, 1.0)


@pytest.mark.parametrize("model", [{}, {"moving": 201}, {"deformed_sh": 4, "moving": 290}, {"deformed_sh": 0}], ids=str)
def test_pictures_are_the_same(model: dict) -> None:
    plain = flickering(**model)
    scene = arranged(plain)
    assert share_deformed(scene.arrays["lifetimes"], len(scene.arrays["embeddings"])) < 0.85
    playable, always, camera = PlayableScene(scene), PlayableScene(without_lifetimes(scene)), odd_camera()
    for time in TIMES:
        found, expected = playable.at(time), always.at(time)
        assert (found.opacities == 0).any() and (found.opacities[: playable.moving] > 0.1).any()
        np.testing.assert_array_equal(draw(found, camera).rgb, draw(expected, camera).rgb)
    of_file, as_it_was = playable.at(0.3), PlayableScene(plain).at(0.3)
    assert len(of_file) == len(as_it_was)
    np.testing.assert_allclose(draw(of_file, camera).rgb, draw(as_it_was, camera).rgb, atol=1e-5)


def test_moments_in_any_order_have_the_same_bits() -> None:
    scene = arranged(flickering(moving=201))
    random = np.random.default_rng(0)
    playable = PlayableScene(scene)
    for time in random.choice(TIMES, 40):
        found, fresh = playable.at(time), PlayableScene(scene).at(time)
        for name in ATTRIBUTES:
            np.testing.assert_array_equal(getattr(found, name), getattr(fresh, name), err_msg=name)
    assert_same_bits(scene, TIMES)


def test_a_part_of_a_scene_shows_the_same() -> None:
    scene = arranged(flickering())
    kept = np.arange(0, 300, 3)
    part, whole, camera = (
        PlayableScene(scene).only(kept),
        PlayableScene(without_lifetimes(scene)).only(kept),
        odd_camera(),
    )
    np.testing.assert_array_equal(draw(part.at(0.3), camera).rgb, draw(whole.at(0.3), camera).rgb)


def test_where_most_can_be_seen_there_are_none() -> None:
    assert "lifetimes" not in arranged(scene_file(300, opacity_reduction="off")).arrays
    single = flickering()
    assert "lifetimes" not in arranged(SceneFile(replace(single.header, frame_count=1), single.arrays)).arrays
    assert "lifetimes" not in arranged(flickering(head_width=8)).arrays


@pytest.mark.parametrize("compact", [False, True])
def test_files_keep_them(tmp_path: Path, compact: bool) -> None:
    scene = arranged(flickering())
    write_scene(tmp_path / "a.frog", scene, compact=compact)
    back = read_scene(tmp_path / "a.frog")
    expected = as_packed(scene) if compact else scene
    assert back.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array, err_msg=name)
    on_device = SceneOnDevice(back, "cpu").at(0.3)
    np.testing.assert_allclose(on_device.opacities.numpy(), PlayableScene(back).at(0.3).opacities, atol=1 / 255)
