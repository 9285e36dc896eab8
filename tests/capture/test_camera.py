from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import odd_camera

from frog_blender.engine.capture.camera import NEUTRAL, Camera, pixel_sizes
from frog_blender.engine.capture.readers.checks import pinhole
from frog_blender.engine.capture.time import frame_to_time, time_to_frame
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.plain_values import UnfitValue


def test_unproject_inverts_project_with_an_off_centre_principal_point() -> None:
    camera = odd_camera(320, 240)
    pixels = np.random.default_rng(0).random((50, 2)) * [320, 240]
    points = camera.unproject(pixels, np.linspace(1, 9, 50))
    projected, depths = camera.project(points)
    np.testing.assert_allclose(projected, pixels, atol=1e-8)
    assert (depths > 0).all()
    np.testing.assert_allclose(np.linalg.norm(points - camera.center, axis=1), np.linspace(1, 9, 50))
    np.testing.assert_allclose(camera.ray_directions(camera.intrinsics[None, :2, 2])[0], camera.forward, atol=1e-12)


def test_resizing_and_cropping_move_projections_with_the_image() -> None:
    camera = odd_camera(320, 240)
    points = camera.unproject(np.array([[100.0, 60.0]]), np.array([3.0]))
    np.testing.assert_allclose(camera.resized(160, 80).project(points)[0], [[50.0, 20.0]])
    np.testing.assert_allclose(camera.cropped(30, 10, 100, 100).project(points)[0], [[70.0, 50.0]])


def test_a_camera_survives_json() -> None:
    camera = odd_camera(320, 240)
    again = Camera.from_json(camera.to_json())
    np.testing.assert_array_equal(again.world_to_camera, camera.world_to_camera)
    np.testing.assert_array_equal(again.intrinsics, camera.intrinsics)
    assert (again.name, again.width, again.height) == ("odd", 320, 240)
    assert again.exposure == NEUTRAL and "exposure" not in camera.to_json()
    brighter = camera.with_exposure((1.2, 1.1, 0.9))
    assert Camera.from_json(brighter.to_json()).resized(8, 8).exposure == (1.2, 1.1, 0.9)


ROUNDED = {(1, 0): 1e-12, (2, 0): -1e-9, (2, 2): 0.9999999}
"""What a calibration that was computed has in the lower part of K."""


@pytest.mark.parametrize("place", ROUNDED)
def test_a_calibration_up_to_rounding_is_read_and_written_alike(place: tuple[int, int]) -> None:
    camera = odd_camera(320, 240)
    lens = camera.intrinsics.copy()
    lens[place] = ROUNDED[place]
    np.testing.assert_array_equal(pinhole(lens, Path("x"), "K"), camera.intrinsics)
    written = camera.to_json() | {"intrinsics": lens.tolist()}
    np.testing.assert_array_equal(Camera.from_json(written).intrinsics, camera.intrinsics)
    lens[place] += 1e-3
    with pytest.raises(FrogError):
        pinhole(lens, Path("x"), "K")
    with pytest.raises(UnfitValue):
        Camera.from_json(camera.to_json() | {"intrinsics": lens.tolist()})


@pytest.mark.parametrize("exposure", [(1.0, 1.0), (1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1.0, float("nan"), 1.0)])
def test_an_exposure_is_three_positive_numbers(exposure: tuple[float, ...]) -> None:
    with pytest.raises(ValueError):
        odd_camera(320, 240).with_exposure(exposure)


def test_frames_and_times_invert_each_other_even_between_frames_and_for_one_frame() -> None:
    assert frame_to_time(29, 30) == 1.0
    assert time_to_frame(frame_to_time(3.25, 30), 30) == 3.25
    assert frame_to_time(0, 1) == 0.0


def test_a_pixel_is_measured_in_the_camera_that_sees_it_finest() -> None:
    camera = odd_camera(320, 240)
    zoomed = replace(camera, intrinsics=np.diag([3.0, 3.0, 1.0]) @ camera.intrinsics).cropped(200, 100, 500, 400)
    pixels = np.random.default_rng(0).random((60, 2)) * [320, 240]
    means = camera.unproject(pixels, np.linspace(1, 9, 60)).astype(np.float32)
    means[0] = camera.center - 3 * camera.forward  # behind both
    focal, depths = camera.intrinsics[:2, :2].max(), camera.project(means.astype(np.float64))[1]
    finer, _ = zoomed.project(means.astype(np.float64))
    is_finer = ((finer >= 0) & (finer <= [500, 400])).all(axis=1) & (depths > 0)
    assert 5 < is_finer.sum() < 55
    expected = np.where(is_finer, depths / (3 * focal), depths / focal)
    expected[0] = 3 / (3 * focal)  # of the nearest, which has the smallest pixels
    np.testing.assert_allclose(pixel_sizes(means, [camera, zoomed]), expected, rtol=1e-4)
