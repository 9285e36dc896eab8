"""Cameras that walk through a room that the tests draw."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.calibration.sequences import film_images
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import CalibrationRefused, find_films
from frog_blender.engine.errors import FrogError

from .rigs import rig_errors
from .walls import FOCAL, camera, film, image, run_in

pytest.importorskip("pycolmap")
NUMBERS = (1, 2, 3, 8, 9, 10, 11, 13, 20)  # of which letters would make another order
WALK = [
    camera(f"frame_{NUMBERS[i]}", (-1.8 + 0.36 * i, 0.25 * np.sin(i), -3.0 - 0.1 * np.cos(i / 2))) for i in range(9)
]


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
    assert capture.is_moving and '"time"' not in outcome.cameras.read_text()  # nothing measured it
    shots = sorted(capture.shots, key=lambda shot: shot.frame)
    assert [shot.frame + 1 for shot in shots] == [*NUMBERS]
    ordered = [capture.cameras[shot.camera] for shot in shots]
    assert rig_errors(ordered, WALK)[0] < 1
    assert abs(ordered[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert not (walked / "transforms.json").exists()


def test_several_moving_cameras_are_refused(tmp_path: Path) -> None:
    for name in "ab":
        film(tmp_path / f"{name}.mp4", [image(each) for each in WALK[:8]])
    with pytest.raises(FrogError, match="found a, b all moving, expected one that moves, or standing cameras"):
        calibrate(tmp_path, Options(), lambda *_: None, lambda: False)


@pytest.mark.parametrize("name", ["cam{}.png", "frame_{}.png"])
def test_images_that_show_nothing_are_refused(tmp_path: Path, name: str) -> None:
    for index in range(8):
        cv2.imwrite(str(tmp_path / name.format(index)), np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(CalibrationRefused):
        calibrate(tmp_path, Options(), lambda *_: None, lambda: False)


@pytest.mark.slow  # the mapper tries long where nothing fits
def test_a_camera_that_turns_on_the_spot_is_refused(tmp_path: Path) -> None:
    turns = [camera("pan", (0, -0.2, -2.5), (-1.3 + 0.3 * i, 0.1 * np.sin(i), 1.5)) for i in range(8)]
    film(tmp_path / "pan.mp4", [image(each) for each in turns])
    with pytest.raises(CalibrationRefused, match="without turning on the spot"):
        calibrate(tmp_path, Options(), lambda *_: None, lambda: False)
    assert not (tmp_path / "transforms.json").exists()


def test_a_film_is_thinned_and_has_enough_frames(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    for name, count in {"long": 601, "short": 5}.items():
        film(tmp_path / f"{name}.mp4", [np.full((32, 48), index % 200, np.uint8) for index in range(count)])
    long, short = find_films(tmp_path)
    sequence, times, warnings = film_images(run, long, tmp_path)
    assert (
        len(sequence.images) == 201 and times[:3] == pytest.approx([0.0, 0.3, 0.6]) and "every 3. frame" in warnings[0]
    )
    with pytest.raises(FrogError, match="found 5 frames, expected at least 8"):
        film_images(run, short, tmp_path)
