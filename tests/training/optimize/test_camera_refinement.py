"""Poses and exposures that are learned with the scene, of cameras whose images can tell them from what it does."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.image_stores import ImageStore
from support.training_steps import Make, train

from frog_blender.engine.capture.camera import NEUTRAL, Camera
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.evaluation.evaluate import open_training_capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.rasterizer import rasterize
from frog_blender.engine.recipes import Recipe, recipe
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize import camera_refinement
from frog_blender.engine.training.optimize.camera_refinement import (
    CameraRig,
    PoseRefinement,
    expected_exposures,
    learnable_cameras,
)
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.checkpoint import restore, state_of
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

POINTS = np.array(
    [[0, 0, 1], [2, 1.5, 1], [-2, 1.5, 1], [2, -1.5, 1], [-2, -1.5, 1.0], [0, 0, -0.5]]
)  # of the wall, and before it


def pixels_off(camera: Camera, expected: Camera) -> float:
    """How far apart two cameras see the wall's middle and corners, pixels."""
    return float(np.linalg.norm(camera.project(POINTS)[0] - expected.project(POINTS)[0], axis=1).mean())


def disagreement(cameras: Sequence[Camera], capture: Capture) -> float:
    """How differently the training cameras are off, pixels: the scene may turn a little with all of them."""
    offsets = [
        own.project(POINTS)[0] - true.project(POINTS)[0] for own, true in zip(cameras, capture.cameras, strict=True)
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
    scene = arrays.mapped(lambda value: torch.from_numpy(np.float32(value)))
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


def test_who_is_refined(capture: Capture, make_trainer: Make) -> None:
    """A rig is; the held-out camera and the papers' recipes are not."""
    trainer, fixed = make_trainer(5), make_trainer(5, pose_reach=0.0, exposure_from=0.85)
    assert trainer.poses and trainer.exposures and not fixed.poses and not fixed.exposures
    assert recipe("paper-exact").pose_reach == 0.0 and recipe("paper-exact").exposure_from == 1.0
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
    askew: Capture, capture: Capture, filmed: Path, tmp_path: Path, lively: Callable[..., Recipe], quick_seeds: None
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
    cameras = scene.header.cameras
    assert pixels_off(cameras[0], capture.cameras[0]) == 0.0
    assert disagreement(cameras, capture) < 0.75 * disagreement(askew.cameras, capture)
    seen = open_training_capture(ScenePlayer(scene), filmed)
    for camera, expected in zip(seen.cameras, scene.header.cameras, strict=True):
        np.testing.assert_array_equal(camera.world_to_camera, expected.world_to_camera)


def test_a_finished_training_that_is_extended_goes_on_downhill(
    make_trainer: Make, monkeypatch: pytest.MonkeyPatch
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


def test_a_shorter_limit_makes_no_step_long(make_trainer: Make) -> None:
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


FACTORS = {"cam01": (0.7, 0.7, 0.7), "cam02": (1.0, 1.0, 1.0), "cam03": (0.8, 0.9, 0.7)}
"""Of the training cameras of ``filmed``; nothing becomes brighter than white by them."""
MEDIAN = np.median(list(FACTORS.values()), axis=0)
"""How bright the scene will be; the held-out camera is exposed so."""


class Exposed(ImageStore):
    """A store of images that each camera exposed otherwise."""

    def __init__(self, store: FrameStore, capture: Capture) -> None:
        self._store, self._capture = store, capture

    def image(self, index: int) -> np.ndarray:
        name = self._capture.cameras[self._capture.shots[index].camera].name
        exposed = self._store.image(index) * np.array(FACTORS.get(name, MEDIAN))
        return exposed.round().clip(0, 255).astype(np.uint8)


@pytest.fixture
def exposed(store: FrameStore, capture: Capture) -> Exposed:
    return Exposed(store, capture)


def found_by(trainer: Trainer) -> dict[str, tuple[float, float, float]]:
    return {camera.name: camera.exposure for camera in trainer.capture.cameras}


def test_exposures_are_found_and_the_scene_gains(make_trainer: Make, exposed: Exposed) -> None:
    plain = train(make_trainer(300, watched=exposed, exposure_from=1.0))
    assert set(found_by(plain).values()) == {NEUTRAL}
    trainer = train(make_trainer(300, watched=exposed))
    exposures = found_by(trainer)
    assert exposures.pop("cam00") == NEUTRAL
    for name, factors in exposures.items():
        np.testing.assert_allclose(factors, np.array(FACTORS[name]) / MEDIAN, rtol=0.1)
    np.testing.assert_allclose(np.median(list(exposures.values()), axis=0), 1.0, rtol=1e-9)
    assert trainer.evaluate(4)[0] > plain.evaluate(4)[0] + 1.0


def test_what_matches_say_is_there_before_the_first_step(make_trainer: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    said = {1: np.array([0.5, 0.5, 0.4]), 2: np.array([1.5, 1.0, 1.0]), 3: np.array([100.0, 1.0, 1.0])}
    monkeypatch.setattr(camera_refinement, "matched_exposures", lambda capture, store: said)
    exposures = found_by(make_trainer(20))
    assert exposures["cam00"] == NEUTRAL
    np.testing.assert_allclose(exposures["cam01"], said[1])
    np.testing.assert_allclose(exposures["cam02"], said[2])
    np.testing.assert_allclose(exposures["cam03"], (4.0, 1.0, 1.0))
    assert set(found_by(make_trainer(20, exposure_from=1.0)).values()) == {NEUTRAL}


def test_what_matches_say_stays(make_trainer: Make, exposed: Exposed, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = make_trainer(60, watched=exposed)
    said = {index: np.full(3, 1.02) for index in begun.capture.train_cameras}
    monkeypatch.setattr(camera_refinement, "matched_exposures", lambda capture, store: said)
    assert found_by(train(make_trainer(60, watched=exposed)))["cam01"] == pytest.approx((1.02, 1.02, 1.02))


def test_a_resume_has_the_same_cameras(make_trainer: Make, capture: Capture, exposed: Exposed) -> None:
    one, other = (make_trainer(60, watched=exposed, pose_reach=0.05) for _ in range(2))
    train(one, until=30)
    restore(other, state_of(one))
    assert found_by(other) == found_by(one) != found_by(make_trainer(60))
    train(one, until=40)
    train(other, until=40)
    assert found_by(one) == found_by(other)
    moved = 0
    for first, second, begun in zip(one.capture.cameras, other.capture.cameras, capture.cameras, strict=True):
        np.testing.assert_array_equal(first.world_to_camera, second.world_to_camera)
        moved += not np.array_equal(first.world_to_camera, begun.world_to_camera)
    assert moved == len(film.CAMERAS) - 1


def test_drawings_and_their_gradients_are_multiplied(capture: Capture) -> None:
    arrays, camera = film.gaussians_at(0), capture.cameras[1]
    brighter = camera.with_exposure((1.5, 1.0, 0.5))
    gradients = []
    for drawn_camera, by in ((camera, (1.5, 1.0, 0.5)), (brighter, (1.0, 1.0, 1.0))):
        scene = arrays.mapped(lambda value: torch.from_numpy(np.float32(value)))
        scene.sh.requires_grad_()
        rgb = rasterize(scene, drawn_camera, (0.1, 0.2, 0.3)).rgb * torch.tensor(by)
        rgb.square().sum().backward()
        gradients.append((rgb.detach(), scene.sh.grad))
    for one, two in zip(*gradients, strict=True):
        torch.testing.assert_close(one, two)
    np.testing.assert_array_equal(draw(arrays, brighter, (0.1, 0.2, 0.3)).rgb, gradients[1][0].numpy())


def with_images(capture: Capture, counts: dict[int, int]) -> Capture:
    """The first so many training images of some cameras, by index, and no others."""
    left, shots = dict(counts), []
    for shot in capture.train_shots:
        if left.get(shot.camera, 0) > 0:
            left[shot.camera] -= 1
            shots.append(shot)
    assert not any(left.values())
    return replace(capture, shots=tuple(shots), test_cameras=frozenset())


def test_of_one_moving_camera_none(capture: Capture) -> None:
    """A reader makes a camera of every place that a moving camera films from: each has one image."""
    first, *_ = capture.train_cameras
    film = [shot for shot in capture.shots if shot.camera == first]
    cameras = tuple(replace(capture.cameras[first], name=f"at{index}") for index in range(len(film)))
    moving = replace(
        capture,
        cameras=cameras,
        distortions=(capture.distortions[first],) * len(film),
        shots=tuple(replace(shot, camera=index) for index, shot in enumerate(film)),
        test_cameras=frozenset(),
    )
    assert len(film) > 2 and moving.train_shots
    assert learnable_cameras(moving) == []


def test_of_cameras_with_an_image_or_two_none(capture: Capture) -> None:
    for count in (1, 2):
        at_several = with_images(capture, dict.fromkeys(capture.train_cameras, count))
        shots = [replace(shot, frame=index) for index, shot in enumerate(at_several.shots)]
        single = replace(at_several, shots=tuple(shots), frame_count=max(capture.frame_count, len(shots)))
        assert learnable_cameras(single) == []


def test_of_a_mixed_capture_those_with_enough_images(capture: Capture) -> None:
    first, second, third = capture.train_cameras
    mixed = with_images(capture, {first: 3, second: 1, third: 4})
    assert learnable_cameras(mixed) == [first, third]


def test_of_a_rig_and_of_one_moment_all_training_cameras(capture: Capture) -> None:
    """At one moment nothing moves, so that each camera is told from the scene by all the others."""
    photos = with_images(capture, dict.fromkeys(capture.train_cameras, 1))
    assert len({shot.frame for shot in photos.shots}) == 1
    for filmed in (capture, photos):
        assert learnable_cameras(filmed) == list(capture.train_cameras)


def test_a_held_out_camera_is_exposed_as_those_around_it() -> None:
    """Where nearness tells: along a row that grows darker, and not where every other camera is dark."""
    row = np.array([[float(index), 0.0, 0.0] for index in range(8)])
    darker = np.linspace(0.2, -0.2, 8)[:, None] * np.array([1.0, 0.5, 1.0])
    inside, beside = expected_exposures(darker, row, np.array([[2.5, 0, 0], [6.5, 0.0, 0.0]]))
    np.testing.assert_allclose(inside, darker[2:4].mean(axis=0), atol=0.04)
    np.testing.assert_allclose(beside, darker[6:].mean(axis=0), atol=0.07)
    every_other = np.where(np.arange(8) % 2, 0.2, -0.2)[:, None].repeat(3, axis=1)
    assert not expected_exposures(every_other, row, row[:1] + 0.5).any()
