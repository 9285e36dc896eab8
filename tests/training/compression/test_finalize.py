"""A finished scene in the order of its file shows what it showed, and packed what is nearly the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import odd_camera, scene_file
from support.training_steps import MakeJob

from frog_blender.engine.model.torch_player import TorchScenePlayer
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.session.export import as_packed, reorder_for_playback
from frog_blender.engine.training.session.run import run_training


@pytest.mark.parametrize("moving", [1, 201, 300])
def test_the_order_is_nobodys_matter(moving: int) -> None:
    plain = scene_file(300, moving=moving)
    scene, camera = reorder_for_playback(plain), odd_camera()
    assert not np.array_equal(scene.arrays["means"], plain.arrays["means"])
    ordered, before = (ScenePlayer(file).at(0.25) for file in (scene, plain))
    np.testing.assert_allclose(draw(ordered, camera).rgb, draw(before, camera).rgb, atol=1e-5)


@pytest.mark.parametrize("compact", [False, True])
def test_files_keep_them(tmp_path: Path, compact: bool) -> None:
    scene = reorder_for_playback(scene_file(300, moving=201))
    write_scene(tmp_path / "a.frog", scene, compact=compact)
    back = read_scene(tmp_path / "a.frog")
    expected = as_packed(scene) if compact else scene
    assert back.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array, err_msg=name)
    on_device, played = TorchScenePlayer(back, "cpu").at_frame(1.5), ScenePlayer(back).at_frame(1.5)
    np.testing.assert_allclose(on_device.opacities.numpy(), played.opacities, atol=1e-5)


@pytest.mark.parametrize("worst", [-100.0, 100.0])
def test_where_packing_shows_files_stay_plain(make_job: MakeJob, tmp_path: Path, worst: float) -> None:
    task = make_job(60, {"compression": CompressionSettings(max_packing_loss=worst)}, capacity="auto")
    finished = list(run_training(task))[-1]
    scene, size = read_scene(task.output), task.output.stat().st_size
    is_packed = finished.capacity["reductions"][-1]["what"] == "packed"
    assert scene.header.capacity == finished.capacity and is_packed == (worst > 0)
    assert is_packed == (size < sum(array.nbytes for array in scene.arrays.values()))
    if is_packed:
        list(run_training(replace(task, output=tmp_path / "y.frog", max_bytes=int(0.9 * size))))
        assert (tmp_path / "y.frog").stat().st_size <= 0.9 * size
