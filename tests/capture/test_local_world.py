"""What a camera computes; captures in map coordinates, tiny and huge: what is taken off before single precision."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.builders import odd_camera
from support.small_captures import llff_row, write_n3dv

from frog_blender.engine.capture.camera import NEUTRAL, Camera
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.readers.checks import pinhole
from frog_blender.engine.capture.time import frame_to_time, time_to_frame
from frog_blender.engine.capture.world import World
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


UTM = np.array([448262.3, 5411932.7, 312.5])


def shifted(folder: Path, shift: np.ndarray, factor: float = 1.0) -> Path:
    """Three cameras at x = 0, 1 and 2, elsewhere and in other units."""
    write_n3dv(folder)
    rows = [llff_row(48, 64, 50.0, tuple(factor * np.array([x, 0, 0]) + shift)) for x in range(3)]
    rows = [np.concatenate([row[:15], factor * row[15:]]) for row in rows]
    np.save(folder / "poses_bounds.npy", np.stack(rows))
    return folder


def test_a_map_s_coordinates_are_taken_off_and_said(tmp_path: Path) -> None:
    plain, far = open_capture(shifted(tmp_path / "a", np.zeros(3))), open_capture(shifted(tmp_path / "b", UTM))
    assert plain.world == World() and not plain.warnings
    origin = np.array(far.world.origin)
    assert np.abs(origin - UTM).max() < 2 and far.world.unit == 1
    assert "(448263, 5411933, 312) + the scene's coordinates" in far.warnings[0]
    for camera, moved in zip(plain.cameras, far.cameras, strict=True):
        np.testing.assert_allclose(moved.center + origin, camera.center + UTM, atol=1e-8)
        np.testing.assert_array_equal(moved.rotation, camera.rotation)
        point = camera.center + np.array([0.3, 0.2, 4.0])
        seen = moved.project(far.world.local_points(point + UTM)[None])[0]
        np.testing.assert_allclose(seen, camera.project(point[None])[0], atol=1e-6)
    assert far.near_far == plain.near_far


@pytest.mark.parametrize(("factor", "unit"), [(3e-5, 1e-5), (4e7, 1e7)])
def test_tiny_and_huge_worlds_are_scaled(tmp_path: Path, factor: float, unit: float) -> None:
    capture = open_capture(shifted(tmp_path, np.zeros(3), factor))
    assert capture.world.unit == pytest.approx(unit)
    np.testing.assert_allclose([camera.center[0] for camera in capture.cameras], factor / unit * np.arange(3))
    np.testing.assert_allclose(capture.near_far, np.array([0.5, 20]) * factor / unit)
    assert f"{unit:g} x the scene's coordinates" in capture.warnings[0]


@pytest.mark.parametrize("distance", [0.0, 50.0])
def test_ordinary_places_stay_as_they_are(tmp_path: Path, distance: float) -> None:
    capture = open_capture(shifted(tmp_path, np.full(3, distance)))
    assert capture.world.is_plain and not capture.warnings
    np.testing.assert_array_equal(capture.cameras[0].center, np.full(3, distance))


def test_a_world_is_read_as_it_was_written() -> None:
    world = World((1.5, -2.0, 5411932.7), 1e-3)
    assert World.from_json(json.loads(json.dumps(world.to_json()))) == world


@pytest.mark.parametrize(
    "data",
    [None, [], {}, {"origin": [0, 0], "unit": 1}, {"origin": [0, 0, 1e13], "unit": 1}]
    + [{"origin": [0, 0, 0], "unit": unit} for unit in (0, -1, 1e300, "1", None)],
)
def test_a_damaged_world_is_refused(data: object) -> None:
    with pytest.raises(UnfitValue):
        World.from_json(data)
