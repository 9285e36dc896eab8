"""Cameras from points that a person clicked."""

from dataclasses import replace

import numpy as np
import pytest

from frog_blender.engine.arrays import Float64s
from frog_blender.engine.capture.calibration.limits import MANY_CLICKS
from frog_blender.engine.capture.calibration.points import calibrate_clicks
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.synchronization.films import CalibrationRefused

from .rigs import TALL, WIDE, around, facts_of, pixels_of, rig_errors

FAR_APART = [0.0, 49.0, 174.0, 230.0]


def room_points(count: int, seed: int) -> Float64s:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-1.2, 1.2, (count, 2)), rng.uniform(0.0, 2.0, count)])


def clicks(cameras: list[Camera], points: Float64s, noise: float, seed: int) -> dict[str, Float64s]:
    rng = np.random.default_rng(seed)
    return {camera.name: pixels_of(camera, points) + rng.normal(0, noise, (len(points), 2)) for camera in cameras}


@pytest.mark.parametrize("seed", range(2))
def test_sixteen_points_two_pixels_off_place_cameras_far_apart(seed: int) -> None:
    cameras = around(FAR_APART, TALL, 1680.0)

    found = calibrate_clicks(facts_of(cameras), clicks(cameras, room_points(MANY_CLICKS, seed), 2.0, seed))

    centers, rotation, focal, _ = rig_errors(found, cameras)
    assert centers < 0.6 and rotation < 0.6 and focal < 2.0
    assert not found.is_metric
    assert [calibrated.camera.name for calibrated in found.cameras] == [camera.name for camera in cameras]


def test_a_few_exact_clicks_give_the_exact_rig_and_a_warning() -> None:
    cameras = around([0.0, 40.0, 80.0], WIDE, 1000.0)

    found = calibrate_clicks(facts_of(cameras), clicks(cameras, room_points(12, 3), 0.0, 0))

    assert max(rig_errors(found, cameras)[:3]) < 1e-3
    assert max(calibrated.support.residual for calibrated in found.cameras) < 1e-3
    assert "are few" in found.warnings[0]


def test_cameras_of_different_kinds_have_focal_lengths_of_their_own() -> None:
    wide, tall = around([0.0, 60.0], WIDE, 900.0), around([120.0, 200.0], TALL, 1900.0)
    cameras = [replace(camera, name=f"c{index}") for index, camera in enumerate((*wide, *tall))]
    facts = [replace(facts, group=index // 2) for index, facts in enumerate(facts_of(cameras))]

    found = calibrate_clicks(facts, clicks(cameras, room_points(30, 4), 0.5, 4))

    centers, _, focal, _ = rig_errors(found, cameras)
    assert centers < 0.5
    assert focal < 1.5


def test_a_point_that_is_another_one_is_found_out() -> None:
    cameras = around(FAR_APART, TALL, 1680.0)
    seen = clicks(cameras, room_points(20, 5), 1.0, 5)
    seen["cam01"][7] += 150.0
    seen["cam03"][10:12] = np.nan  # not seen

    found = calibrate_clicks(facts_of(cameras), seen)

    assert rig_errors(found, cameras)[0] < 0.6
    assert found.cameras[1].support.share < 1.0
    assert (found.cameras[1].observations[:, 2] == 0).sum() == 1


def test_too_few_points_are_refused_with_the_camera_s_name() -> None:
    cameras = around(FAR_APART, TALL, 1680.0)
    seen = clicks(cameras, room_points(16, 7), 1.0, 7)
    seen["cam02"][5:] = np.nan

    with pytest.raises(CalibrationRefused, match="Camera cam02 has 5 points"):
        calibrate_clicks(facts_of(cameras), seen)
    del seen["cam02"]
    with pytest.raises(CalibrationRefused, match="Camera cam02 has 0 points"):
        calibrate_clicks(facts_of(cameras), seen)


@pytest.mark.slow  # the mapper tries long where nothing fits
def test_a_camera_that_was_clicked_at_random_is_refused() -> None:
    cameras = around(FAR_APART[:3], TALL, 1680.0)
    seen = clicks(cameras, room_points(20, 8), 1.0, 8)
    seen["cam02"] = np.random.default_rng(8).uniform(0, TALL, (20, 2))

    with pytest.raises(CalibrationRefused):
        calibrate_clicks(facts_of(cameras), seen)
