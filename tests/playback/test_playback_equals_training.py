"""A scene written to a file and played without torch is the scene that training ended with."""

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import torch
from support.builders import odd_camera, scene_file
from support.torch_player import TorchScenePlayer

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw, to_uint8
from frog_blender.engine.rasterizer import RasterizeOptions, rasterize
from frog_blender.engine.scene.scene_file import SceneFile, write_scene

FRAMES = (-1, 0, 0.08, 1.5, 3, 5.4, 6, 9)


SHAPES = [
    {"head_width": 0, "deformed_sh": 0},
    {"head_width": 0, "deformed_sh": 1},
    {"head_width": 0, "deformed_sh": 4, "hidden_width": 16},
    {"head_width": 0, "deformed_sh": 4, "hidden_width": 33, "embedding_size": 3, "temporal_size": 5},
    {"head_width": 24, "deformed_sh": 0, "hidden_width": 17},
    {"head_width": 24, "deformed_sh": 1},
    {"head_width": 24, "deformed_sh": 4, "hidden_width": 40},
    {"head_width": 16, "deformed_sh": 9, "hidden_width": 32},
    {"opacity_reduction": "paper", "motion_unit": 2.5},
    {"opacity_reduction": "off"},
    {"opacity_reduction": "unit", "opacity_sharpness": 3.0},
    {"temporal_rows": 2, "coarse_rows": 2},
    {"fine_rows": 4, "opacity_share": 0.3},
    *[{"fusion": fusion} for fusion in ("add", "concat", "attention", "coarse", "fine", "dual")],
    {"fusion": "dual", "deformed_sh": 4, "hidden_width": 33},
    {"fusion": "dual", "head_width": 24, "deformed_sh": 4, "hidden_width": 17},
    {"fusion": "concat", "head_width": 24},
    {"modulation": True},
    {"modulation": True, "fusion": "dual", "deformed_sh": 4, "hidden_width": 33},
    {"modulation": True, "fusion": "concat", "head_width": 24},
]


@pytest.mark.parametrize(("shape", "moving"), [*zip(SHAPES, cycle([41, 40, 17, 1]), strict=False)], ids=str)
def test_gaussians_at_many_times(tmp_path: Path, shape: dict, moving: int, count: int = 41) -> None:
    scene = scene_file(count, sh_count=16 if shape.get("deformed_sh") == 9 else 4, moving=moving, **shape)
    write_scene(tmp_path / "x.frog", scene)
    played, on_device = ScenePlayer.load(tmp_path / "x.frog"), TorchScenePlayer(scene)
    assert (played.count, played.num_dynamic) == (count, moving)
    still = torch.from_numpy(scene.arrays["means"])
    for frame in FRAMES:
        found, expected = played.at_frame(frame), on_device.at_frame(frame)
        moved = (expected.means - still).abs().amax(1)
        assert float(moved[:moving].max()) > 0.01 and not moved[moving:].any()
        expected.quaternions = torch.nn.functional.normalize(expected.quaternions, dim=1)
        for name in ATTRIBUTES:
            values, tensor = getattr(found, name), getattr(expected, name)
            assert values.dtype == np.float32 and values.flags.c_contiguous
            assert tensor.dtype == torch.float32 and not tensor.requires_grad
            np.testing.assert_allclose(values, tensor.numpy(), rtol=1e-5, atol=1e-5, err_msg=name)


def test_times_outside_are_held_and_frames_are_times(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    scene = ScenePlayer.load(tmp_path / "x.frog")
    for frame, time in ((0, 0.0), (3, 0.5), (4.5, 0.75), (6, 1.0), (99, 1.0), (-2, 0.0)):
        np.testing.assert_array_equal(scene.at_frame(frame).means, scene.at(time).means)
    assert np.abs(scene.at(0.5).means - scene.at(0.6).means).max() > 1e-4


@pytest.mark.parametrize("method", ["static", "frog"])
def test_a_scene_in_which_nothing_moves_plays_too(tmp_path: Path, method: str) -> None:
    scene = scene_file()
    arrays = {name: scene.arrays[name] for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}
    header = type(scene.header)(**{**vars(scene.header), "method": method, "model": {}})
    write_scene(tmp_path / "x.frog", SceneFile(header, arrays))
    played = ScenePlayer.load(tmp_path / "x.frog")
    assert played.num_dynamic == 0
    np.testing.assert_array_equal(played.at(0.1).means, arrays["means"])
    np.testing.assert_allclose(played.at(0.9).scales, np.exp(arrays["log_scales"]))
    np.testing.assert_allclose(np.linalg.norm(played.at(0.5).quaternions, axis=1), 1, rtol=1e-6)


def test_drawing_without_torch_is_drawing_with_it(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file(80))
    gaussians = ScenePlayer.load(tmp_path / "x.frog").at(0.4)
    camera = odd_camera(53, 38)
    drawing = draw(gaussians, camera, (0.1, 0.2, 0.3))
    image = rasterize(gaussians.mapped(torch.tensor), camera, (0.1, 0.2, 0.3), RasterizeOptions(depth=True))
    np.testing.assert_array_equal(drawing.rgb, image.rgb.detach().numpy())
    np.testing.assert_array_equal(drawing.alpha, image.alpha.detach().numpy())
    np.testing.assert_array_equal(drawing.mean_depth, image.mean_depth.numpy())
    np.testing.assert_allclose(drawing.median_depth, image.median_depth.numpy(), rtol=1e-5)
    for name in ("rgb", "alpha", "median_depth", "median_z", "mean_depth"):
        assert getattr(drawing, name).dtype == np.float32


def test_bytes_are_rounded_and_clipped() -> None:
    values = np.array([-1.0, 0.4999 / 255, 0.5001 / 255, 0.5, 1.0, 7.0])
    assert to_uint8(values).tolist() == [0, 0, 1, 128, 255, 255]
