"""Rigs of many kinds, by points that they would see: found within half a per cent, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from frog_blender.engine.capture.camera import Camera

from .rigs import looking, rig_errors
from .sightings import as_cameras, room, solved, wall

pytest.importorskip("pycolmap")

SIZE = (640, 480)


def arc(count: int, step: float, focals: tuple[float, ...] = (640.0,)) -> list[Camera]:
    """Cameras about the room's middle, none of them set up exactly."""
    random = np.random.default_rng(count)
    cameras = []
    for number in range(count):
        angle = np.radians(step * (number - (count - 1) / 2))
        place = [2.6 * np.sin(angle), -2.6 * np.cos(angle), 1.3 + 0.3 * (number % 3)]
        target = [0.0, 0.0, 0.9]
        place, target = (np.add(each, random.normal(0, 0.15, 3)).tolist() for each in (place, target))
        cameras.append(looking(f"cam{number}", SIZE, focals[number % len(focals)], place, target))
    return cameras


def facing_wall(toe: float) -> list[Camera]:
    """Two rows of three before a wall: parallel with 0, each looking at the middle with 1."""
    places = [(0.7 * (number % 3 - 1), -1.8 + 0.1 * (number % 2), 1.2 + 0.6 * (number // 3)) for number in range(6)]
    return [
        looking(f"cam{number}", SIZE, 640.0, (x, y, z), ((1 - toe) * x, 2.0, 1.4 + (1 - toe) * (z - 1.4)))
        for number, (x, y, z) in enumerate(places)
    ]


@pytest.mark.parametrize(("count", "step"), [(3, 15.0), (5, 28.0)])
def test_an_arc_is_found(count: int, step: float) -> None:
    cameras = arc(count, step)
    solution = solved(cameras, room(1500, count))
    assert solution.refusal is None
    centers, rotations, focals, _ = rig_errors(as_cameras(solution), cameras)
    assert centers < 0.5 and rotations < 0.2 and focals < 1.0
    assert all(lens.k1 == lens.k2 == 0 for lens in solution.model.lenses)  # none is believed where there is none


@pytest.mark.parametrize("seed", [0, 2])
def test_few_points_do_not_lead_to_focal_lengths_of_their_own(seed: int) -> None:
    cameras = arc(6, 12.0)
    solution = solved(cameras, room(280, seed), seed)
    assert len({lens.focal for lens in solution.model.lenses}) == 1
    centers = rig_errors(as_cameras(solution), cameras)[0]
    assert centers < 0.5 or solution.refusal or solution.warnings
    assert centers < 3.0


@pytest.mark.parametrize("k1", [-0.2, pytest.param(0.08, marks=pytest.mark.slow)])
def test_a_distortion_is_found(k1: float) -> None:
    cameras = arc(5, 12.0, (500.0,))
    solution = solved(cameras, room(800, 3), k1=k1)
    assert solution.refusal is None
    assert all(abs(lens.k1 - k1) < 0.02 for lens in solution.model.lenses)
    assert rig_errors(as_cameras(solution), cameras)[0] < 0.5


def test_unequal_focal_lengths_are_found() -> None:
    cameras = arc(5, 12.0, (450.0, 830.0, 580.0, 700.0, 510.0))
    solution = solved(cameras, room(1200, 5))
    assert len({lens.focal for lens in solution.model.lenses}) == 5
    assert solution.refusal is None
    assert rig_errors(as_cameras(solution), cameras)[0] < 0.5


def test_parallel_cameras_before_a_wall_are_refused() -> None:
    cameras = facing_wall(0.0)
    solution = solved(cameras, wall(1500, 6))
    sentence = solution.refusal
    assert sentence is not None and "focal length" in sentence and "Turn the cameras" in sentence


def test_cameras_that_look_at_one_place_of_a_wall_are_found() -> None:
    cameras = facing_wall(1.0)
    solution = solved(cameras, wall(1500, 7))
    centers = rig_errors(as_cameras(solution), cameras)[0]
    assert centers < 0.5 or solution.warnings or solution.refusal
    assert centers < 3.0
