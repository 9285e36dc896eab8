"""Frames of scenes by the CUDA kernels, emulated, are the native library's; what fails is drawn by that."""

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from emulated import Emulator
from support.builders import odd_camera, random_gaussians, scene_file
from support.equality import FLIPPED_SHARE

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import NumpyGaussians
from frog_blender.engine.playback import render
from frog_blender.engine.playback.painter import painter
from frog_blender.engine.playback.passes import vector_pass
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.rasterizer.cuda_frame import fill, try_frames
from frog_blender.engine.scene.scene_file import write_scene
from frog_blender.engine.training.optimize import device as devices

CPU = torch.device("cpu")
CAMERA = odd_camera()
SHAPES = {
    "whole": {},
    "region": {"options": RasterizeOptions(region=(5, 3, 31, 20), near_plane=2.0)},
    "depth limit": {"depth_limit": np.linspace(2, 6, 27 * 45, dtype=np.float32).reshape(27, 45)},
    "background": {"background": (0.2, 0.4, 0.9)},
}


@pytest.fixture(autouse=True)
def own_painter() -> Iterator[None]:
    """Each test's process has a painter that nobody has asked for anything."""
    painter.cache_clear()
    yield
    painter.cache_clear()


@pytest.fixture
def on_gpu(emulator: Emulator) -> Callable[[bool], None]:
    """Switches between the emulated GPU and the native library."""

    def switch(on: bool) -> None:
        painter().gpu = partial(fill, CPU) if on else None

    return switch


def gaussians_of(count: int, degree: int = 1) -> NumpyGaussians:
    """With a low-pass of each, as of captures that are drawn together, read-only as of a player."""
    gaussians = replace(random_gaussians(CAMERA, count, degree, seed=3), low_pass=np.linspace(0, 1, count)).checked()
    for array in gaussians.arrays.values():
        array.flags.writeable = False
    return gaussians


def assert_alike(found: np.ndarray, expected: np.ndarray, name: str) -> None:
    """Within the tolerance of the kernels' tests: float32 decides few thresholds the other way."""
    assert (found.dtype, found.shape) == (expected.dtype, expected.shape), name
    wrong = ~np.isclose(found, expected, rtol=2e-5, atol=2e-5, equal_nan=True)
    assert wrong.sum() <= max(3, FLIPPED_SHARE * wrong.size), f"{name}: {wrong.sum()} of {wrong.size} differ"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("shape", SHAPES)
def test_every_pass_is_the_native_librarys(shape: str, on_gpu: Callable[[bool], None], emulator: Emulator) -> None:
    gaussians, camera = gaussians_of(150), replace(CAMERA, exposure=(1.2, 0.9, 1.0))
    expected = render.draw(gaussians, camera, **SHAPES[shape])
    assert not emulator.launched
    on_gpu(True)
    found = render.draw(gaussians, camera, **SHAPES[shape])
    assert [kernel.name for kernel in emulator.launched] == ["project", "scan", "emit", "sort", "blend"]
    assert expected.alpha.max() > 0.9 and (expected.median_index >= 0).any()
    for field in fields(expected):
        if field.name != "notice":
            assert_alike(getattr(found, field.name), getattr(expected, field.name), field.name)


def test_other_pictures_too(on_gpu: Callable[[bool], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes in bands, motion vectors, and nothing at all."""
    monkeypatch.setattr(render, "_PIXELS_AT_ONCE", 10 * CAMERA.width)
    gaussians = gaussians_of(80)
    moved = gaussians.changed({"means": gaussians.means + np.float32(0.05)})

    def pictures() -> list[np.ndarray]:
        snapshots = {-1: moved, 0: gaussians, 1: None}
        vectors = vector_pass(lambda offset: (snapshots[offset], CAMERA), RasterizeOptions())
        nothing = render.draw(gaussians.part(slice(0)), CAMERA).alpha
        return [render.render_image(gaussians, CAMERA, (0.1, 0.5, 0.9)), vectors, nothing]

    expected = pictures()
    on_gpu(True)
    image, vectors, nothing = pictures()
    assert np.abs(image.astype(int) - expected[0]).mean() < 0.01
    assert np.abs(expected[1]).max() > 0.1 and np.isclose(vectors, expected[1], atol=1e-3).mean() > 0.995
    assert not nothing.any()


def test_what_the_gpu_refuses_is_drawn_and_said_once(emulator: Emulator) -> None:
    gaussians = gaussians_of(100)
    expected = render.draw(gaussians, CAMERA)
    emulator.memory = 10_000
    painter().gpu = partial(fill, CPU)
    first, second = (render.draw(gaussians, CAMERA) for _ in range(2))
    assert "GPU could not draw" in first.notice and "GiB" in first.notice and not second.notice
    for found in (first, second):
        np.testing.assert_array_equal(found.rgb, expected.rgb)
        np.testing.assert_array_equal(found.median_index, expected.median_index)
    emulator.reset()
    render.draw(gaussians, CAMERA)
    assert emulator.launched, "a smaller image may fit again"


def test_a_gpu_is_asked_for_once_and_only_where_much_is_drawn() -> None:
    asked = []
    painter().ask_after(1e9, lambda: asked.append("late"))
    render.draw(gaussians_of(5), CAMERA)
    assert not asked
    painter().ask_after(0.0, lambda: asked.append("now"))
    for _ in range(2):
        render.draw(gaussians_of(5), CAMERA)
    assert asked == ["now"]


def test_the_trial_compares_frames(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> None:
    try_frames(CPU)
    right = emulator.launch

    def wrong(kernel: object, *arguments: object) -> None:
        right(kernel, *arguments)
        if kernel.name == "blend":
            arguments[10][0] += 1  # the median's index, in one row

    monkeypatch.setattr(emulator, "launch", wrong)
    with pytest.raises(FrogError, match="median_index is not what"):
        try_frames(CPU)


@pytest.fixture
def pretended(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Torch sees a GPU, which is the emulator."""
    monkeypatch.setattr(devices, "first_gpu", lambda: torch.device("cuda", 0))
    monkeypatch.setattr(devices, "try_frames", lambda device: None)
    monkeypatch.setattr(devices, "fill", lambda device, *request: fill(CPU, *request))


def test_frog_render_draws_any_image_on_a_gpu(pretended: None, emulator: Emulator, tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file(30))
    images = []
    for device in ("cpu", "cuda", "auto", "cpu"):
        emulator.launched.clear()
        words = [
            "--camera",
            "odd",
            "--frames",
            "2:3",
            "--alpha",
            "straight",
            "--out",
            str(tmp_path),
            "--device",
            device,
        ]
        assert main(["render", str(tmp_path / "x.frog"), *words]) == 0
        images.append(cv2.imread(str(tmp_path / "odd_0002.png"), cv2.IMREAD_UNCHANGED).astype(int))
        assert bool(emulator.launched) == (device != "cpu")
    assert np.abs(images[1] - images[0]).mean() < 0.01 and (images[1] == images[2]).all()
    assert images[0].shape[2] == 4 and images[0].std() > 10 and (images[3] == images[0]).all()


def test_a_gpu_whose_frames_are_wrong_is_left_aside(
    pretended: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(device: torch.device) -> None:
        raise FrogError("The picture is green.")

    monkeypatch.setattr(devices, "try_frames", refuse)
    assert devices.draw_frames_on("auto") == "The GPU is left aside for the CPU: The picture is green."
    assert painter().gpu is None
    write_scene(tmp_path / "x.frog", scene_file(30))
    words = ["--camera", "odd", "--out", str(tmp_path), "--device", "cuda"]
    assert main(["render", str(tmp_path / "x.frog"), *words]) == 1
    assert "'cuda' cannot be used: The picture is green." in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="torch can use the GPU")
def test_a_gpu_that_torch_cannot_use_breaks_no_picture() -> None:
    painter().gpu = partial(fill, torch.device("cuda", 0))
    drawing = render.draw(gaussians_of(20), CAMERA)
    assert drawing.alpha.any() and "GPU could not draw" in drawing.notice
