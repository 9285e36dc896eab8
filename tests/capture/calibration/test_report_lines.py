"""What ``frog info --check`` prints of a calibration's report, and what its page draws."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frog_blender.cli.info_command import _checked
from frog_blender.engine.capture.calibration.camera_files import write_cameras
from frog_blender.engine.capture.calibration.model import Lens, MovingCamera
from frog_blender.engine.capture.calibration.report import (
    REPORT,
    from_above,
    report_lines,
    write_moving_report,
    write_report,
)
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.pairs import Curve
from frog_blender.engine.capture.synchronization.synchronization import CameraClock, Synchronization

from .rigs import WIDE, looking
from .test_result_files import calibrated

WARNING = "cam01 sees little of what the others see."


def synchronization(names: list[str]) -> Synchronization:
    lags = np.linspace(-1, 1, 5)
    clocks = [CameraClock(name, 0.1, 1.0, 0.9, ("motion",), None, Curve(lags, lags)) for name in names]
    return Synchronization(tuple(clocks), 0.04, 0.002)


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    """A capture with the report of its calibration."""
    calibration, films = calibrated(tmp_path)
    calibration = replace(calibration, warnings=(WARNING,), halves_apart=0.0012)
    write_cameras(tmp_path, calibration, films)
    found = synchronization([film.name for film in films])
    write_report(tmp_path, calibration, films, found)
    return open_capture(tmp_path)


def test_the_report_is_said_again(capture: Capture) -> None:
    camera = capture.cameras[0]
    first, *cameras, clocks, warning = report_lines(capture)
    assert first == (
        "3 standing cameras from features, 2 points, two halves of what was seen put the cameras 0.12 % of their "
        "extent apart"
    )
    focal = f"focal length {camera.intrinsics[0, 0]:.1f} px within 0.1 %"
    assert len(cameras) == 3 and cameras[0] == f"{camera.name}: median residual 0.20 px, {focal}"
    assert clocks == "synchronization: residual 0.0020 s (0.05 frames)" and warning == WARNING
    told = _checked(capture)  # the command prints it before its own look
    assert next(iter(told)) == "calibration" and told["calibration"] == report_lines(capture) and told["found"]


def test_a_report_of_other_cameras_says_so_and_none_says_nothing(capture: Capture) -> None:
    path = capture.path / REPORT
    facts = json.loads(path.read_text())
    facts["cameras"][1]["focal"] *= 1.1
    path.write_text(json.dumps(facts))
    assert report_lines(capture)[0] == "This report is of another calibration than the one in use."
    path.unlink()
    assert report_lines(capture) == [] and "calibration" not in _checked(capture)


def test_a_moving_cameras_report(capture: Capture) -> None:
    poses, told = np.tile(np.eye(4)[:3], (86, 1, 1)), ("One image could not be placed.",)
    lens, nothing = Lens(640, 480, 500.0), np.empty((0, 3))
    found = MovingCamera(lens, tuple(range(86)), poses, nothing, 0.41, 0.001, 0.002, told)
    write_moving_report(capture.path, found)
    assert report_lines(capture) == [
        "one moving camera, 86 images, median residual 0.41 px, two halves of what was seen put the cameras 0.2 % of "
        "their extent apart",
        "One image could not be placed.",
    ]


@pytest.mark.parametrize(
    "content", ["", "[]", '{"lines": [4]}', '{"lines": [], "cameras": [{"name": "a", "focal": "b"}]}']
)
def test_a_damaged_report_is_one_sentence(capture: Capture, content: str) -> None:
    (capture.path / REPORT).write_text(content)
    (sentence,) = report_lines(capture)
    assert REPORT in sentence and "found" in sentence and "expected" in sentence


# --- drawings


ROW = [looking(f"cam{index}", WIDE, 1000.0, (0.5 * index - 0.5, 0.0, 1.0), (0.0, 3.0, 1.0)) for index in range(3)]
WALL = np.column_stack([np.linspace(-1.0, 1.0, 101), np.full(101, 3.0), np.ones(101)])  # six halves of the row away


def test_cameras_in_a_row_are_shown_with_what_they_film() -> None:
    dots, eyes = from_above(ROW, WALL, 500)
    assert len(dots) > 90 and (np.abs(dots - 250) <= 250).all() and (np.abs(eyes - 250) <= 250).all()
    assert eyes[0, 0, 0] < eyes[1, 0, 0] < eyes[2, 0, 0] and (eyes[:, 1, 1] < eyes[:, 0, 1]).all()  # they look up


def test_a_far_background_leaves_the_cameras_apart() -> None:
    far = np.array([[0.0, 1000.0, 1.0], [300.0, 2000.0, 1.0]])
    dots, eyes = from_above(ROW, WALL, 500)
    with_far = from_above(ROW, np.concatenate([WALL, far]), 500)
    assert np.allclose(with_far[1], eyes) and len(with_far[0]) == len(dots)
