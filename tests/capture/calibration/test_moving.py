"""Cameras that walk through a room that the tests draw."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.clocks import find_moving_clocks
from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.calibration.sequences import sampled
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import Film
from frog_blender.engine.capture.synchronization.run import CalibrationRefused, Run, WorkFolder
from frog_blender.engine.capture.video import VideoFacts
from frog_blender.engine.errors import FrogError

from .walls import FOCAL, camera, center_errors, film, image

pytest.importorskip("pycolmap")
WALK = [camera(f"{i:03d}", (-1.8 + 0.36 * i, 0.25 * np.sin(i), -3.0 - 0.1 * np.cos(i / 2))) for i in range(9)]
BACK = [camera(f"back{i}", (1.7 - 0.4 * i, -0.2 + 0.2 * np.cos(i), -2.6 - 0.2 * np.sin(i / 2))) for i in range(8)]


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    (folder / "images").mkdir()
    for each in WALK:
        cv2.imwrite(str(folder / "images" / f"{each.name}.png"), image(each))
    return folder


def test_a_walk_becomes_a_capture(walked: Path, tmp_path: Path) -> None:
    outcome = calibrate(walked, Options(out=tmp_path), lambda *_: None, lambda: False)
    assert outcome.cameras == tmp_path / "transforms.json"
    capture = open_capture(tmp_path)
    assert capture.is_moving and capture.frame_count == len(WALK)
    ordered = [capture.cameras[shot.camera] for shot in capture.shots]
    assert center_errors(ordered, WALK).max() < 0.01
    assert abs(ordered[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert not (walked / "transforms.json").exists()


@pytest.mark.slow
def test_two_moving_cameras_share_a_world_and_a_clock(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", [image(each) for each in WALK[:8]])
    film(tmp_path / "b.mp4", [image(each) for each in BACK])
    options = Options(clocks={"a": (0.0, 1.0), "b": (0.2, 1.0)})  # the second begins two frames later
    calibrate(tmp_path, options, lambda *_: None, lambda: False)
    capture = open_capture(tmp_path)
    assert capture.frames_per_second == pytest.approx(10.0) and capture.frame_count == 10
    names = [f"{camera}_images/{frame:06d}" for camera in "ab" for frame in range(8)]
    shots = [next(shot for shot in capture.shots if name in shot.path.as_posix()) for name in names]
    assert [shot.frame for shot in shots] == [*range(8), *range(2, 10)]
    assert center_errors([capture.cameras[shot.camera] for shot in shots], [*WALK[:8], *BACK]).max() < 0.01
    assert json.loads((tmp_path / "calibration_report.json").read_text())["kind"] == "2 moving cameras"


def test_a_camera_that_turns_on_the_spot_is_refused(tmp_path: Path) -> None:
    turns = [camera("pan", (0, -0.2, -2.5), (-1.3 + 0.3 * i, 0.1 * np.sin(i), 1.5)) for i in range(8)]
    film(tmp_path / "pan.mp4", [image(each) for each in turns])
    with pytest.raises(CalibrationRefused, match="without turning on the spot"):
        calibrate(tmp_path, Options(), lambda *_: None, lambda: False)
    assert not (tmp_path / "transforms.json").exists()


def facts(name: str, count: int, rate: float = 30.0, offset: float = 0.0) -> Film:
    return Film(name, Path(f"{name}.mp4"), VideoFacts(320, 240, count, rate, np.arange(count) / rate), offset)


def test_a_long_film_is_thinned() -> None:
    ((frames,), step) = sampled([facts("a", 1800)])
    assert step == 6 and frames == list(range(0, 1800, 6))


def test_frames_of_several_films_are_taken_at_one_time() -> None:
    films = [facts("a", 900), facts("b", 450, 15.0, 1.0)]
    (first, second), _ = sampled(films)
    assert len(first) + len(second) < 320 and min(len(first), len(second)) > 100
    times = [films[0].time_of(frame) for frame in first]
    assert all(min(abs(films[1].time_of(frame) - time) for time in times) < 1 / 30 for frame in second[:100])


def test_a_film_of_few_frames_is_no_moving_camera() -> None:
    with pytest.raises(FrogError, match="found 5 frames, expected at least 8"):
        sampled([facts("a", 5)])


def test_films_without_sound_or_timecode_are_taken_to_be_in_step_and_that_is_said(tmp_path: Path) -> None:
    for name in "ab":
        film(tmp_path / f"{name}.mp4", [image(each) for each in WALK[:4]])
    films = [Film(name, tmp_path / f"{name}.mp4", facts(name, 4).facts) for name in "ab"]
    found = find_moving_clocks(Run(WorkFolder(tmp_path), lambda *_: None, lambda: False), films)
    assert found.clocks == {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    assert "taken to be in step" in found.warnings[0]
