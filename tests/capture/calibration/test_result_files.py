"""What was given stays, whatever a calibration finds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from frog_blender.engine.capture.calibration.calibration import CalibratedCamera, Calibration, CameraSupport
from frog_blender.engine.capture.calibration.camera_files import is_calibrated, write_cameras
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import Film
from frog_blender.engine.capture.video import read_facts

from .walls import film, image, rig

EVIDENCE = CameraSupport(100, 0.9, 50, 0.2, 0.5, 0.001)


def calibrated(folder: Path, k1: float = 0.0) -> tuple[Calibration, list[Film]]:
    cameras, films = [], []
    for camera in rig()[:3]:
        path = folder / f"{camera.name}.mp4"
        film(path, [image(camera)] * 4)
        films.append(Film(camera.name, path, read_facts(path)))
        cameras.append(CalibratedCamera(camera, (k1, 0.0), EVIDENCE, np.zeros((0, 3))))
    return Calibration(tuple(cameras), np.zeros((2, 3))), films


def test_the_result_is_a_capture(tmp_path: Path) -> None:
    calibration, films = calibrated(tmp_path, k1=-0.1)
    assert write_cameras(tmp_path, calibration, films).name == "cameras_opencv.json"
    capture = open_capture(tmp_path)
    assert capture.format == "calibrated_videos" and capture.frame_count == 4
    for camera, true in zip(capture.cameras, rig(), strict=False):
        assert np.allclose(camera.world_to_camera, true.world_to_camera, atol=1e-9)
        assert np.allclose(camera.intrinsics, true.intrinsics)
    assert capture.distortions[0] is not None and capture.distortions[0].coefficients[0] == -0.1


def test_a_given_calibration_is_left_as_it_is(tmp_path: Path) -> None:
    calibration, films = calibrated(tmp_path)
    given = tmp_path / "cameras_opencv.json"
    given.write_text('{"mine": 1}')
    found = write_cameras(tmp_path, calibration, films)
    assert found.name == "cameras_found.json" and given.read_text() == '{"mine": 1}'
    found.write_text("corrected by hand")
    assert write_cameras(tmp_path, calibration, films).name == "cameras_found_2.json"
    assert found.read_text() == "corrected by hand"


def test_a_calibration_of_another_kind_counts_as_given(tmp_path: Path) -> None:
    calibration, films = calibrated(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 17)))
    assert write_cameras(tmp_path, calibration, films).name == "cameras_found.json"
    assert not (tmp_path / "cameras_opencv.json").exists()


def test_the_same_result_is_not_written_twice(tmp_path: Path) -> None:
    calibration, films = calibrated(tmp_path)
    first = write_cameras(tmp_path, calibration, films)
    assert write_cameras(tmp_path, calibration, films) == first
    assert [path.name for path in tmp_path.glob("*.json")] == [first.name]


def test_elsewhere_it_names_its_videos_and_their_clocks(tmp_path: Path) -> None:
    (tmp_path / "films").mkdir()
    calibration, films = calibrated(tmp_path / "films")
    films[1] = Film(films[1].name, films[1].path, films[1].facts, 0.25, 1.001)
    path = write_cameras(tmp_path / "out" / "deep", calibration, films)
    entries = json.loads(path.read_text())["cameras"]
    assert entries[0]["video"] == "../../films/cam0.mp4" and "offset" not in entries[0]
    assert (entries[1]["offset"], entries[1]["rate"]) == (0.25, 1.001)


def test_a_capture_in_a_folder_below_is_no_calibration_of_this_one(tmp_path: Path) -> None:
    below = tmp_path / "test shoot"
    below.mkdir()
    calibration, films = calibrated(below)
    write_cameras(below, calibration, films)
    assert is_calibrated(below) and not is_calibrated(tmp_path)
