"""Exposure and pose are learned of cameras whose images can tell them from what the scene does."""

from __future__ import annotations

from dataclasses import replace

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.training.optimize.camera_refinement import (
    ExposureCompensation,
    PoseRefinement,
    learnable_cameras,
)


def is_learned(capture: Capture) -> bool:
    """Exposures and poses are learned of the same cameras."""
    wanted = {each.applies_to(capture, Recipe()) for each in (ExposureCompensation, PoseRefinement)}
    assert len(wanted) == 1
    return wanted.pop()


def with_images(capture: Capture, counts: dict[int, int]) -> Capture:
    """The first so many training images of some cameras, by index, and no others."""
    left, shots = dict(counts), []
    for shot in capture.train_shots:
        if left.get(shot.camera, 0) > 0:
            left[shot.camera] -= 1
            shots.append(shot)
    assert not any(left.values())
    return replace(capture, shots=tuple(shots), test_cameras=frozenset())


def test_of_a_rig_all_training_cameras(capture: Capture) -> None:
    assert learnable_cameras(capture) == list(capture.train_cameras)
    assert is_learned(capture)


def test_of_one_moving_camera_none(capture: Capture) -> None:
    """A reader makes a camera of every place that a moving camera films from: each has one image."""
    first, *_ = capture.train_cameras
    film = [shot for shot in capture.shots if shot.camera == first]
    cameras = tuple(replace(capture.cameras[first], name=f"at{index}") for index in range(len(film)))
    moving = replace(
        capture,
        cameras=cameras,
        distortions=(capture.distortions[first],) * len(film),
        crops=(capture.crops[first],) * len(film),
        shots=tuple(replace(shot, camera=index) for index, shot in enumerate(film)),
        test_cameras=frozenset(),
    )
    assert len(film) > 2 and moving.train_shots
    assert learnable_cameras(moving) == [] and not is_learned(moving)


def test_of_cameras_with_an_image_or_two_none(capture: Capture) -> None:
    for count in (1, 2):
        at_several = with_images(capture, dict.fromkeys(capture.train_cameras, count))
        shots = [replace(shot, frame=index) for index, shot in enumerate(at_several.shots)]
        single = replace(at_several, shots=tuple(shots), frame_count=max(capture.frame_count, len(shots)))
        assert learnable_cameras(single) == [] and not is_learned(single)


def test_of_a_mixed_capture_those_with_enough_images(capture: Capture) -> None:
    first, second, third = capture.train_cameras
    mixed = with_images(capture, {first: 3, second: 1, third: 4})
    assert learnable_cameras(mixed) == [first, third] and is_learned(mixed)


def test_of_one_moment_all_cameras(capture: Capture) -> None:
    """Nothing moves, so that each camera is told from the scene by all the others."""
    photos = with_images(capture, dict.fromkeys(capture.train_cameras, 1))
    assert len({shot.frame for shot in photos.shots}) == 1
    assert learnable_cameras(photos) == list(capture.train_cameras) and is_learned(photos)
