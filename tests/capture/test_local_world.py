"""Captures in map coordinates, and of tiny and huge worlds: what is taken off before single precision."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.small_captures import llff_row, write_n3dv

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.world import World
from frog_blender.engine.io.plain_values import UnfitValue

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
