"""Cameras that walk through a room that the tests draw, alone or to connect standing cameras that share nothing."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.calibration.sequences import film_images, walk_images, walk_throughs
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import CalibrationRefused, Run, find_films
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.child_process import Stopped
from frog_blender.engine.io.work_folder import WorkFolder

from .rigs import rig_errors
from .walls import FOCAL, camera, film, films, image, run_in

pytest.importorskip("pycolmap")
NUMBERS = (1, 2, 3, 8, 9, 10, 11, 13, 20)  # of which letters would make another order
WALK = [
    camera(f"frame_{NUMBERS[i]}", (-1.8 + 0.36 * i, 0.25 * np.sin(i), -3.0 - 0.1 * np.cos(i / 2))) for i in range(9)
]


def test_a_walk_becomes_a_capture(tmp_path: Path) -> None:
    walked, out = tmp_path / "walk", tmp_path / "out"
    (walked / "images").mkdir(parents=True)
    for view in WALK:
        cv2.imwrite(str(walked / "images" / f"{view.name}.png"), image(view))
    outcome = calibrate(walked, Options(out=out), lambda *_: None, lambda: False)
    assert outcome.cameras == out / "transforms.json"
    capture = open_capture(out)
    assert capture.is_moving and '"time"' not in outcome.cameras.read_text()  # nothing measured it
    shots = sorted(capture.shots, key=lambda shot: shot.frame)
    assert [shot.frame + 1 for shot in shots] == [*NUMBERS]
    ordered = [capture.cameras[shot.camera] for shot in shots]
    assert rig_errors(ordered, WALK)[0] < 1
    assert abs(ordered[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert not (walked / "transforms.json").exists()


def test_several_moving_cameras_are_refused(tmp_path: Path) -> None:
    for name in "ab":
        film(tmp_path / f"{name}.mp4", [image(view) for view in WALK[:8]])
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
    film(tmp_path / "pan.mp4", [image(view) for view in turns])
    with pytest.raises(CalibrationRefused, match="without turning on the spot"):
        calibrate(tmp_path, Options(), lambda *_: None, lambda: False)
    assert not (tmp_path / "transforms.json").exists()


def test_a_film_is_thinned_and_has_enough_frames(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    for name, count in {"long": 601, "short": 5}.items():
        film(tmp_path / f"{name}.mp4", [np.full((32, 48), index % 200, np.uint8) for index in range(count)])
    long, short = find_films(tmp_path)
    sequence, warnings = film_images(run, long, tmp_path)
    assert len(sequence.images) == 201 and "every 3. frame" in warnings[0]
    assert sequence.times is not None and sequence.times[:3] == pytest.approx((0.0, 0.3, 0.6))
    with pytest.raises(FrogError, match="found 5 frames, expected at least 8"):
        film_images(run, short, tmp_path)


# --- walk-throughs


APART = [
    camera("left", (-2.3, -0.2, -0.9), (-2.2, 0.1, 2.5)),
    camera("middle", (-0.5, -0.5, -1.6), (-1.0, 0.0, 1.6)),
    camera("right", (1.7, -0.3, -1.0), (1.5, 0.1, 1.5)),
]
"""Neighbours see next to nothing of the same things; the left one and the right one nothing at all."""
SCAN = [
    camera("scan", (-2.3 + 0.31 * i, -0.3 + 0.15 * np.sin(i), -1.6 + 0.3 * np.cos(i / 2)), (-2 + 0.27 * i, 0, 2.2))
    for i in range(15)
]


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scanned")
    for view in APART:
        film(folder / f"{view.name}.mp4", [image(view)] * 6)
    film(folder / "Scan.mp4", [image(view) for view in SCAN])
    return folder


@pytest.mark.slow
def test_a_walk_through_connects_cameras_that_share_nothing(footage: Path, tmp_path: Path) -> None:
    outcome = calibrate(footage, Options(out=tmp_path, in_step=True), lambda *_: None, lambda: False)
    assert not any("failed" in warning for warning in outcome.warnings)
    capture = open_capture(tmp_path)
    assert [view.name for view in capture.cameras] == ["left", "middle", "right"]
    assert rig_errors(capture.cameras, APART)[0] < 2
    assert abs(capture.cameras[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert '"source": "a walk-through"' in outcome.report.read_text()


@pytest.mark.slow
def test_a_walk_through_of_another_place_is_not_believed(footage: Path, tmp_path: Path) -> None:
    for view in APART:
        (tmp_path / f"{view.name}.mp4").write_bytes((footage / f"{view.name}.mp4").read_bytes())
    film(tmp_path / "scan_1.mp4", [image(view, seed=40) for view in SCAN])
    with pytest.raises(FrogError, match="walk-through does not show enough of what left, middle and right see"):
        calibrate(tmp_path, Options(background_only=True), lambda *_: None, lambda: False)
    assert not (tmp_path / "cameras_opencv.json").exists()


def test_walk_throughs_are_known_by_name_or_by_being_alone_in_moving() -> None:
    found, told = walk_throughs(Path("set"), films("a", "b", "SCAN_2", "scan"), [True, True, False, False])
    assert [film.name for film in found] == ["SCAN_2", "scan"] and not told
    found, told = walk_throughs(Path("set"), films("a", "b", "phone"), [True, True, False])
    assert [film.name for film in found] == ["phone"] and "used as a walk-through" in told[0]
    assert walk_throughs(Path("set"), films("scan", "b"), [True, True]) == ([], [])
    assert walk_throughs(Path("set"), films("scan", "b"), [False, False]) == ([], [])


def test_two_unnamed_films_that_move_beside_standing_ones_are_refused() -> None:
    with pytest.raises(FrogError, match="found x, y moving beside standing cameras"):
        walk_throughs(Path("set"), films("a", "x", "y"), [True, False, False])


def test_reading_a_walk_through_can_be_cancelled(footage: Path, tmp_path: Path) -> None:
    (scan,) = (shown for shown in find_films(footage) if shown.name == "Scan")
    with pytest.raises(Stopped):
        walk_images(Run(WorkFolder(tmp_path), lambda *_: None, lambda: True), [scan])
    (sequence,) = walk_images(run_in(tmp_path), [scan])
    assert len(sequence.images) == len(SCAN) and sequence.size == (320, 240)
