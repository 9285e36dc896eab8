"""Poses that are learned with the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.training_steps import train

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.evaluation.evaluate import open_training_capture
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.rasterizer import GaussianArrays, rasterize
from frog_blender.engine.recipes import Recipe, recipe
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize import camera_refinement
from frog_blender.engine.training.optimize.camera_refinement import CameraRig, PoseRefinement
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.checkpoint import restore, state_of
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

POINTS = np.array(
    [[0, 0, 1], [2, 1.5, 1], [-2, 1.5, 1], [2, -1.5, 1], [-2, -1.5, 1.0], [0, 0, -0.5]]
)  # of the wall, and before it


def pixels_off(found: Camera, expected: Camera) -> float:
    """How far apart two cameras see the wall's middle and corners, pixels."""
    return float(np.linalg.norm(found.project(POINTS)[0] - expected.project(POINTS)[0], axis=1).mean())


def disagreement(found: Sequence[Camera], capture: Capture) -> float:
    """How differently the training cameras are off, pixels: the scene may turn a little with all of them."""
    offsets = [
        own.project(POINTS)[0] - true.project(POINTS)[0] for own, true in zip(found, capture.cameras, strict=True)
    ]
    return float(np.linalg.norm(np.std(offsets[1:], axis=0), axis=1).mean())


def test_a_camera_finds_back_to_where_it_was(capture: Capture) -> None:
    """The scene is known here, so the pose alone has to explain the image."""
    index = 2
    true = capture.cameras[index]
    wrong = true.moved(np.radians([0.5, -0.4, 0.8]), np.array([0.02, -0.03, 0.05]))
    cameras = [wrong if camera is true else camera for camera in capture.cameras]
    rig = CameraRig(capture.with_cameras(cameras))
    poses = PoseRefinement(rig, Recipe(pose_reach=0.1, pose_from=0.0), np.zeros(3), 4.0)
    arrays = film.gaussians_at(0)  # the wall's rows are equally deep, and would change places at the first turn
    arrays.means[:, 2] += np.random.default_rng(0).normal(0, 0.3, len(arrays.means))
    scene = GaussianArrays(*[torch.from_numpy(np.float32(value)) for value in vars(arrays).values()])
    truth = rasterize(scene, true, (0.0, 0.0, 0.0)).rgb.detach()
    before = pixels_off(wrong, true)
    steps = 200
    for step in range(steps):
        camera = rig.capture.cameras[index]
        pose = torch.from_numpy(camera.world_to_camera[:3]).float().requires_grad_()
        (rasterize(scene, camera, (0.0, 0.0, 0.0), pose=pose).rgb - truth).abs().mean().backward()
        assert pose.grad is not None
        poses.observe(index, pose.grad, step / steps)
    poses.synchronize()
    after = pixels_off(rig.capture.cameras[index], true)
    assert before > 0.8 and after < 0.05 * before
    rotation = rig.capture.cameras[index].rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)


def test_who_is_refined(capture: Capture) -> None:
    """A rig is; the held-out camera and the papers' recipes are not."""
    assert PoseRefinement.applies_to(capture, Recipe())
    assert not PoseRefinement.applies_to(capture, Recipe(pose_reach=0.0))
    assert not PoseRefinement.applies_to(capture, recipe("paper"))
    poses = PoseRefinement(CameraRig(capture), Recipe(), np.zeros(3), 4.0)
    names = [camera.name for camera in capture.cameras]
    assert [poses.learns(names.index(name), 1.0) for name in film.CAMERAS] == [False, True, True, True]
    assert not poses.learns(names.index("cam01"), 0.0)


@pytest.fixture
def askew(capture: Capture) -> Capture:
    """The capture with two of its training cameras a pixel and a half off."""
    turns = {"cam01": (0.0, 0.03, 0.0), "cam03": (-0.03, 0.0, 0.0)}
    return capture.with_cameras(
        camera.moved(np.array(turns.get(camera.name, (0.0, 0.0, 0.0))), np.zeros(3)) for camera in capture.cameras
    )


def test_a_training_mends_its_poses(
    askew: Capture,
    capture: Capture,
    filmed: Path,
    tmp_path: Path,
    lively: Callable[..., Recipe],
    quick_seeds: None,
) -> None:
    """What is written and played has the mended poses, and the held-out camera is where it was."""
    psnr = {}
    for reach in (0.0, 0.1):
        job = TrainingJob(
            filmed, tmp_path / f"{reach}.frog", recipe=replace(lively(400), pose_reach=reach), opened=askew
        )
        *_, psnr[reach] = [event.psnr for event in run_training(job) if isinstance(event, events.Evaluated)]
    scene = read_scene(job.output)
    assert psnr[0.1] > psnr[0.0] + 0.5
    found = scene.header.cameras
    assert pixels_off(found[0], capture.cameras[0]) == 0.0
    assert disagreement(found, capture) < 0.75 * disagreement(askew.cameras, capture)
    seen = open_training_capture(ScenePlayer(scene), filmed)
    for found, expected in zip(seen.cameras, scene.header.cameras, strict=True):
        np.testing.assert_array_equal(found.world_to_camera, expected.world_to_camera)


def test_a_resume_has_the_same_poses(make_trainer: Callable[..., Trainer], capture: Capture) -> None:
    one, other = make_trainer(60, pose_reach=0.05), make_trainer(60, pose_reach=0.05)
    while one.step_count < 40:
        one.step()
        if one.step_count == 25:
            restore(other, state_of(one))
    train(other, until=40)
    moved = 0
    for first, second, begun in zip(one.capture.cameras, other.capture.cameras, capture.cameras, strict=True):
        np.testing.assert_array_equal(first.world_to_camera, second.world_to_camera)
        moved += not np.array_equal(first.world_to_camera, begun.world_to_camera)
    assert moved == len(film.CAMERAS) - 1


def test_a_finished_training_that_is_extended_goes_on_downhill(
    make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every change of a pose is against its gradients' mean, and as long as the training that went by."""
    done, longer = make_trainer(40, pose_reach=0.05), make_trainer(80, pose_reach=0.05)
    train(done)
    restore(longer, state_of(done))
    poses = longer.poses
    assert longer.progress == 0.5 and poses is not None and (poses.moved[:, 1] <= 0.5).all()
    uphill, largest, bare = [], [], camera_refinement.without_common

    def watched(changes: np.ndarray, centers: np.ndarray) -> np.ndarray:
        uphill.append((changes * poses.moments[0, longer.capture.train_cameras]).max())
        largest.append(np.abs(changes[:, :3]).max())
        return bare(changes, centers)

    monkeypatch.setattr(camera_refinement, "without_common", watched)
    train(longer)
    assert len(uphill) > 5 and max(uphill) <= 0 and max(largest) > 1e-5


def test_a_shorter_limit_makes_no_step_long(make_trainer: Callable[..., Trainer]) -> None:
    begun, shorter = make_trainer(200, pose_reach=0.05), make_trainer(60, pose_reach=0.05)
    train(begun, until=50)
    restore(shorter, state_of(begun))
    restore(shorter, state_of(shorter))  # as a training does that goes back
    poses, spans = shorter.poses, []
    assert shorter.progress == 0.25 and poses is not None
    while not shorter.finished:
        last = poses.moved[:, 1].copy()
        shorter.step()
        spans.append(float((poses.moved[:, 1] - last).max()))
    assert min(spans) == 0.0 and 0 < max(spans) < 11 / 60
