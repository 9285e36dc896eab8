"""Standing cameras that share nothing, and a walk-through that connects them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.calibration.sequences import walk_images, walk_throughs
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import Run, find_films
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.child_process import Stopped
from frog_blender.engine.io.work_folder import WorkFolder

from .rigs import rig_errors
from .walls import FOCAL, camera, film, films, image, run_in

pytest.importorskip("pycolmap")
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
    for each in APART:
        film(folder / f"{each.name}.mp4", [image(each)] * 6)
    film(folder / "Scan.mp4", [image(each) for each in SCAN])
    return folder


@pytest.fixture(scope="module")
def out(footage: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    outcome = calibrate(footage, Options(out=out, in_step=True), lambda *_: None, lambda: False)
    assert not any("failed" in warning for warning in outcome.warnings)
    return out


@pytest.mark.slow
def test_a_walk_through_connects_cameras_that_share_nothing(out: Path) -> None:
    capture = open_capture(out)
    assert [each.name for each in capture.cameras] == ["left", "middle", "right"]
    assert rig_errors(capture.cameras, APART)[0] < 2
    assert abs(capture.cameras[0].intrinsics[0, 0] / FOCAL - 1) < 0.02
    assert '"source": "a walk-through"' in (out / "calibration_report.json").read_text()


@pytest.mark.slow
def test_a_walk_through_of_another_place_is_not_believed(footage: Path, tmp_path: Path) -> None:
    for each in APART:
        (tmp_path / f"{each.name}.mp4").write_bytes((footage / f"{each.name}.mp4").read_bytes())
    film(tmp_path / "scan_1.mp4", [image(each, seed=40) for each in SCAN])
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
    (scan,) = (each for each in find_films(footage) if each.name == "Scan")
    with pytest.raises(Stopped):
        walk_images(Run(WorkFolder(tmp_path), lambda *_: None, lambda: True), [scan])
    (sequence,) = walk_images(run_in(tmp_path), [scan])
    assert len(sequence.images) == len(SCAN) and sequence.size == (320, 240)
