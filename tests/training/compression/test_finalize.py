"""A finished scene in the order of its file shows what it showed, and says what of it cannot be seen when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import ATTRIBUTES, odd_camera, scene_file
from support.played_scenes import assert_same_bits, flickering, without_lifetimes

from frog_blender.engine.model.torch_player import TorchScenePlayer
from frog_blender.engine.playback.deformation import mean_deformed_share
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.compression_report import reduction_line
from frog_blender.engine.scene.scene_file import SceneFile, read_scene, write_scene
from frog_blender.engine.training.compression.finalize import as_packed, reorder_for_playback
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

pytestmark = pytest.mark.usefixtures("quick_seeds")

TIMES = (0.0, 1 / 6, 0.3, 0.5, 0.77, 5 / 6, 1.0)
QUARTERS = [k / 24 for k in range(25)]
"""Of the seven frames, and what lies between them."""


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("model", [{}, {"moving": 201}, {"deformed_sh": 4, "moving": 290}, {"deformed_sh": 0}], ids=str)
def test_images_are_the_same(model: dict, packed: bool) -> None:
    plain = flickering(**model)
    scene = as_packed(reorder_for_playback(plain)) if packed else reorder_for_playback(plain)
    assert mean_deformed_share(scene.arrays["lifetimes"], len(scene.arrays["embeddings"])) < 0.85
    playable, always, camera = ScenePlayer(scene), ScenePlayer(without_lifetimes(scene)), odd_camera()
    moments = {time: (playable.at(time), always.at(time)) for time in QUARTERS}
    assert all((found.opacities == 0).any() for found, _ in moments.values())
    assert any((found.opacities[: playable.num_dynamic] > 0.1).any() for found, _ in moments.values())
    for found, expected in moments.values():
        np.testing.assert_array_equal(draw(found, camera).rgb, draw(expected, camera).rgb)


@pytest.mark.parametrize("frames", [2, 7])
def test_the_order_is_nobodys_matter(frames: int) -> None:
    plain = flickering()
    plain = SceneFile(replace(plain.header, frame_count=frames), plain.arrays)
    scene, camera = reorder_for_playback(plain), odd_camera()
    found = ScenePlayer(scene).at(0.25), ScenePlayer(plain).at(0.25)
    np.testing.assert_allclose(*(draw(each, camera).rgb for each in found), atol=1e-5)
    assert len(scene.arrays.get("lifetimes", [0])) == frames - 1
    unfinished = reorder_for_playback(plain, finished=False)
    assert "lifetimes" not in unfinished.arrays and len(unfinished.arrays["means"]) == 300


def test_times_in_any_order_have_the_same_bits() -> None:
    scene = reorder_for_playback(flickering(moving=201))
    random = np.random.default_rng(0)
    playable = ScenePlayer(scene)
    for time in random.choice(TIMES, 40):
        found, fresh = playable.at(time), ScenePlayer(scene).at(time)
        for name in ATTRIBUTES:
            np.testing.assert_array_equal(getattr(found, name), getattr(fresh, name), err_msg=name)
    assert_same_bits(scene, TIMES)


def test_a_part_of_a_scene_shows_the_same() -> None:
    scene, camera = reorder_for_playback(flickering(moving=201)), odd_camera()
    kept = np.delete(np.arange(300), [3, 90, 91, 230])
    part, whole = ScenePlayer(scene).subset(kept), ScenePlayer(without_lifetimes(scene)).subset(kept)
    left_out = [sum(int((each.at(time).opacities == 0).sum()) for time in QUARTERS) for each in (part, whole)]
    assert left_out[0] > left_out[1]
    for time in QUARTERS:
        np.testing.assert_array_equal(draw(part.at(time), camera).rgb, draw(whole.at(time), camera).rgb)
    still = ScenePlayer(scene).subset(np.arange(201, 300))
    assert still.num_dynamic == 0 and len(still.at(0.5)) == 99


def test_where_most_can_be_seen_there_are_none() -> None:
    assert "lifetimes" not in reorder_for_playback(scene_file(300, opacity_reduction="off")).arrays
    single = flickering()
    assert (
        "lifetimes" not in reorder_for_playback(SceneFile(replace(single.header, frame_count=1), single.arrays)).arrays
    )
    assert "lifetimes" not in reorder_for_playback(flickering(head_width=8)).arrays


@pytest.mark.parametrize("compact", [False, True])
def test_files_keep_them(tmp_path: Path, compact: bool) -> None:
    scene = reorder_for_playback(flickering())
    write_scene(tmp_path / "a.frog", scene, compact=compact)
    back = read_scene(tmp_path / "a.frog")
    expected = as_packed(scene) if compact else scene
    assert back.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array, err_msg=name)
    on_device, played = TorchScenePlayer(back, "cpu").at_frame(1.5), ScenePlayer(back).at_frame(1.5)
    np.testing.assert_allclose(on_device.opacities.numpy(), played.opacities, atol=1 / 255)


@pytest.mark.parametrize("worth", [0.0, 2.0])
def test_a_training_says_what_its_lifetimes_save(filmed: Path, tmp_path: Path, lively: Callable, worth: float) -> None:
    settings = CompressionSettings(max_visible=worth)
    task = TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(60, capacity="auto"), compression=settings)
    finished = list(run_training(task))[-1]
    scene = read_scene(task.output)
    assert ("lifetimes" in scene.arrays) == (worth > 1)
    found = [each for each in finished.capacity["reductions"] if each["what"] == "unseen left out"]
    assert len(found) == (worth > 1) and scene.header.capacity == finished.capacity
    for each in found:
        assert 0 < each["after"] <= each["before"] == len(scene.arrays["embeddings"]) and abs(each["loss"]) < 1e-6
        assert "Gaussians deformed a frame" in reduction_line(each)
    if worth < 1:
        return
    size = task.output.stat().st_size
    list(run_training(replace(task, output=tmp_path / "y.frog", max_bytes=int(0.9 * size))))
    assert (tmp_path / "y.frog").stat().st_size <= 0.9 * size


def test_where_packing_shows_files_stay_plain_and_keep_lifetimes(
    filmed: Path, tmp_path: Path, lively: Callable
) -> None:
    settings = CompressionSettings(max_visible=2.0, max_packing_loss=-100.0)
    task = TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(60, capacity="auto"), compression=settings)
    finished = list(run_training(task))[-1]
    whats = [each["what"] for each in finished.capacity["reductions"]]
    assert "packed" not in whats and whats[-1] == "unseen left out"
    scene = read_scene(task.output)
    assert "lifetimes" in scene.arrays and task.output.stat().st_size > sum(a.nbytes for a in scene.arrays.values())
