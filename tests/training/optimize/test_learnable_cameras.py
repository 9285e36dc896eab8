"""Of which cameras exposure and pose are learned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pytest

from frog_blender.engine.capture.capture import Capture, Shot
from frog_blender.engine.training.optimize.exposure_compensation import ExposureCompensation
from frog_blender.engine.training.optimize.learnable_cameras import learnable_cameras
from frog_blender.engine.training.optimize.pose_refinement import PoseRefinement
from frog_blender.engine.training.recipe import Recipe


def filmed_by(capture: Capture, images: Iterable[tuple[int, int]]) -> Capture:
    """The capture with only these (camera, frame) for training; the cameras are those that ``capture`` trains on, again
    and again."""
    images = list(images)
    base = [capture.cameras[index] for index in capture.train_cameras]
    count = 1 + max(camera for camera, _ in images)
    cameras = tuple(replace(base[index % len(base)], name=f"taken{index}") for index in range(count))
    shots = tuple(Shot(camera, frame, capture.shots[0].path, 0) for camera, frame in images)
    frame_count = 1 + max(frame for _, frame in images)
    lenses, crops = (None,) * count, ((0.0, 0.0),) * count
    return replace(
        capture,
        cameras=cameras,
        distortions=lenses,
        crops=crops,
        shots=shots,
        frame_count=frame_count,
        test_cameras=frozenset(),
    )


RIG = [(camera, frame) for camera in range(3) for frame in range(4)]
REGIMES = {
    "rig": (RIG, [0, 1, 2]),
    "one moving camera": ([(index, index) for index in range(8)], []),
    "moving cameras that share moments": ([(index, index // 2) for index in range(8)], []),
    "one moment": ([(index, 0) for index in range(8)], list(range(8))),
    "one camera that stands": ([(0, frame) for frame in range(8)], []),
    "mixed": ([*RIG, *((3 + frame, frame) for frame in range(4))], [0, 1, 2]),
    "a camera that stopped early": ([*RIG, (3, 0), (3, 1)], [0, 1, 2]),
}


@pytest.mark.parametrize("regime", REGIMES)
def test_who_is_told_from_the_scene(capture: Capture, regime: str) -> None:
    images, expected = REGIMES[regime]
    filmed = filmed_by(capture, images)
    assert learnable_cameras(filmed) == expected
    for kind in (PoseRefinement, ExposureCompensation):
        assert kind.wanted(filmed, Recipe()) == bool(expected)


def test_one_standing_camera_that_judges_makes_no_rig(capture: Capture) -> None:
    """As in D-NeRF's scenes: each training image another camera, all held-out images one."""
    judged = filmed_by(capture, [*((index, index) for index in range(6)), *((6, frame) for frame in range(6))])
    assert learnable_cameras(replace(judged, test_cameras=frozenset({"taken6"}))) == []
