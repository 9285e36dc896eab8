"""Cameras and clocks from points that move, in one adjustment."""

from __future__ import annotations

import numpy as np

from frog_blender.engine.arrays import Float64s
from frog_blender.engine.capture.calibration.points import PointViews, solve_points
from frog_blender.engine.capture.camera import Camera

from .rigs import TALL, around, facts_of, pixels_of, rig_errors, skeleton

LATE = np.array([0.0, 0.03, -0.02, 0.015])  # seconds


def walked(camera: Camera, times: Float64s) -> Float64s:
    """(T, 16, 2) where a camera sees the joints of somebody who walks."""
    return np.stack([pixels_of(camera, skeleton(time)) for time in times])


def seen(cameras: list[Camera], noise: float, *, timed: bool) -> PointViews:
    """Joints that each camera saw later than the others by LATE, and how they move there."""
    times, random = np.linspace(0, 6, 40), np.random.default_rng(0)
    pixels, moving = [], []
    for camera, late in zip(cameras, LATE, strict=True):
        pixels.append(walked(camera, times + late) + random.normal(0, noise, (len(times), 16, 2)))
        moving.append((walked(camera, times + late + 0.03) - walked(camera, times + late - 0.03)) / 0.06)
    velocities = np.nan_to_num(np.stack(moving)).reshape(4, -1, 2) if timed else None
    return PointViews(facts_of(cameras), np.zeros(4, int), np.stack(pixels).reshape(4, -1, 2), 0.016, "", velocities)


def test_clocks_are_found_with_the_cameras() -> None:
    cameras = around([0.0, 49.0, 174.0, 230.0], TALL, 1680.0, distance=4.0)
    timed = solve_points(seen(cameras, 4.0, timed=True))
    assert np.allclose(timed.delays, -LATE, atol=0.003)
    assert timed.delays[0] == 0 and (np.abs(timed.delays + LATE)[1:] < 4 * timed.delay_sigmas[1:]).all()
    centers, rotations, focals, _ = rig_errors(timed.calibration, cameras)
    untimed = solve_points(seen(cameras, 4.0, timed=False))
    assert centers < 0.4 and rotations < 0.4 and focals < 1.0
    assert centers < rig_errors(untimed.calibration, cameras)[0] and not untimed.delays.any()
