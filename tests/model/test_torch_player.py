"""A scene played by torch is the one that plays without it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.builders import scene_file

from frog_blender.cli.main import main
from frog_blender.cli.render_command import frame_renderer
from frog_blender.engine.errors import FrogError
from frog_blender.engine.model.torch_player import TorchScenePlayer
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import write_scene


def test_images() -> None:
    scene = scene_file(30, modulation=True)
    on_device, played = TorchScenePlayer(scene, "cpu"), ScenePlayer(scene)
    camera = scene.header.cameras[0]
    expected = draw(played.at_frame(2.5), camera, scene.header.background).rgb
    np.testing.assert_allclose(on_device.render_image(2.5, camera), expected, atol=1e-5)


def test_scenes_that_torch_does_not_play() -> None:
    scene = scene_file(5)
    with pytest.raises(FrogError, match="static"):
        TorchScenePlayer(replace(scene, header=replace(scene.header, method="static")), "cpu")
    del scene.arrays["embeddings"]
    with pytest.raises(FrogError):
        TorchScenePlayer(scene, "cpu")


def test_the_command(tmp_path: Path) -> None:
    scene = scene_file(30)
    write_scene(tmp_path / "x.frog", scene)
    if torch.cuda.is_available():
        pytest.skip("there is a GPU, whose images may differ by a rounding")
    for device in ("cpu", "auto"):
        options = ["--camera", "odd", "--frames", "0:2", "--out", str(tmp_path / device), "--device", device]
        assert main(["render", str(tmp_path / "x.frog"), *options]) == 0
    first, second = ((tmp_path / device / "odd_0001.png").read_bytes() for device in ("cpu", "auto"))
    assert first == second
    with pytest.raises(FrogError, match="no NVIDIA GPU"):
        frame_renderer(scene, "cuda")
