"""``frog calibrate`` from videos on disk to a capture that opens: by which source, and by which clocks."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import refused
from support.json_schema import check

from frog_blender.cli.main import main
from frog_blender.engine.capture.calibration import pipeline
from frog_blender.engine.capture.calibration.board_detection import Board
from frog_blender.engine.capture.calibration.model import Calibration
from frog_blender.engine.capture.calibration.pipeline import TIMES, Options, Outcome, Source, alternated, calibrate
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import NAME, CalibrationRefused, Film
from frog_blender.engine.capture.synchronization.synchronization import Synchronization
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.child_process import Stopped

from .rigs import around, board_poses, rig_errors
from .test_board import photographed
from .test_report_lines import synchronization
from .walls import film, films, image, rig, texture

pytest.importorskip("pycolmap")
BOARD = Board(5, 4, square=0.12, marker=0.75, dictionary="DICT_4X4_50")
BOARD_FILE = "squares = [5, 4]\nsquare_size = 0.12\nmarker_size = 0.09\ndictionary = 'DICT_4X4_50'\n"
WALL = 110  # of what ``photographed`` shows beside the board


@pytest.fixture(scope="module")
def board_footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras that see a board before a papered wall; it fills little enough for the wall to be seen at rest."""
    folder = tmp_path_factory.mktemp("board")
    cameras = around([0.0, 30.0], (640, 480), 640.0, distance=1.5)
    poses = board_poses(16, 21, tilt=0.45)
    for pose in poses:
        pose[:3, :3] = cameras[0].rotation.T @ pose[:3, :3]
        pose[:3, 3] = pose[:3, 3] / 4 + [0.0, 0.0, 0.7] - pose[:3, :3] @ [0.3, 0.24, 0.0]
    for index, camera in enumerate(cameras):
        paper = texture(7 + index)[:480]
        shots = [photographed(BOARD, camera, pose) for pose in poses]
        film(folder / f"{camera.name}.avi", [np.where(shot == WALL, paper, shot) for shot in shots])
    return folder


@pytest.fixture(scope="module")
def room_footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for view in rig():
        film(folder / f"{view.name}.mp4", [image(view)] * 3)
    return folder


@pytest.fixture(scope="module")
def looked_at(board_footage: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run that features refuse keeps of the board's films."""
    out = tmp_path_factory.mktemp("looked at")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FROG_CACHE", str(out / "cache"))
        patch.setattr(pipeline, "board_in_films", lambda *_: None)
        with pytest.raises(CalibrationRefused):
            run(board_footage, Options(out=out))
    return out / NAME


def report_of(outcome: Outcome) -> dict:
    return json.loads(outcome.report.read_text())


def run(folder: Path, options: Options) -> Outcome:
    return calibrate(folder, replace(options, in_step=True), lambda *_: None, lambda: False)


def test_a_given_board_finds_the_cameras(board_footage: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(BOARD_FILE)
    out = tmp_path / "out"

    command = ["calibrate", str(board_footage), "--board", str(tmp_path / "mine.toml"), "--in-step", "--out", str(out)]
    assert main(command) == 0

    found = open_capture(out).cameras
    true = around([0.0, 30.0], (640, 480), 640.0, distance=1.5)
    baseline = np.linalg.norm(true[0].center - true[1].center)
    assert np.linalg.norm(found[0].center - found[1].center) == pytest.approx(baseline, rel=0.03)
    report = json.loads((out / "calibration_report.json").read_text())
    assert (report["source"], report["halves_apart"], report["warnings"]) == ("a board", None, [])
    page = (out / "calibration_report.html").read_text()
    assert "2 standing cameras from a board" in page and "Two halves" not in page and "pairs of cameras" not in page


def test_a_board_that_lies_beside_the_films_is_used(board_footage: Path, tmp_path: Path) -> None:
    for path in board_footage.glob("*.avi"):
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "charuco.toml").write_text(BOARD_FILE)
    outcome = run(tmp_path, Options())
    assert report_of(outcome)["source"] == "a board" and not outcome.warnings


def test_a_board_is_looked_for_where_features_are_refused(board_footage: Path, looked_at: Path, tmp_path: Path) -> None:
    shutil.copytree(looked_at, tmp_path / NAME)
    outcome = run(board_footage, Options(out=tmp_path))
    assert report_of(outcome)["source"] == "a board"
    first, *others = outcome.warnings
    assert first.startswith("The cameras come from a board, because features failed: 2 standing cameras")
    assert any("the rig's scale is arbitrary" in warning for warning in others)


def test_films_without_a_board_are_refused_where_one_was_asked_for(room_footage: Path, tmp_path: Path) -> None:
    refused("found no board in the films", run, room_footage, Options(out=tmp_path, board=pipeline.ANY_BOARD))
    (tmp_path / "mine.toml").write_text(BOARD_FILE)
    with pytest.raises(CalibrationRefused, match="shows the board in 0 of 3 images"):
        run(room_footage, Options(out=tmp_path, board=tmp_path / "mine.toml"))


def test_looking_for_a_board_can_be_cancelled(board_footage: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(BOARD_FILE)
    stages: list[str] = []
    options = Options(out=tmp_path, in_step=True, board=tmp_path / "mine.toml")
    with pytest.raises(Stopped):
        calibrate(board_footage, options, lambda now: stages.append(now.stage), lambda: "Finding the board" in stages)
    assert "bundle adjustment" not in stages and not list(tmp_path.glob("*.json"))


# --- from features


def test_videos_become_a_capture(room_footage: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(room_footage), "--in-step"]) == 0
    assert "cameras_opencv.json: the cameras" in capsys.readouterr().out
    capture = open_capture(room_footage)
    assert rig_errors(capture.cameras, rig())[0] < 1
    report = json.loads((room_footage / "calibration_report.json").read_text())
    assert [camera["name"] for camera in report["cameras"]] == [camera.name for camera in rig()]
    assert len(report["pairs"]) == 10
    page = (room_footage / "calibration_report.html").read_text()
    assert page.count("<svg") == 1 and page.count("data:image/jpeg") == 5
    # A second run finds the same, and overwrites nothing.
    before = (room_footage / "cameras_opencv.json").read_bytes()
    assert main(["calibrate", str(room_footage), "--in-step"]) == 0
    assert (room_footage / "cameras_opencv.json").read_bytes() == before


def test_folders_of_frames_become_a_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cameras = rig()[1:4]
    for view in cameras:
        (tmp_path / view.name).mkdir()
        for index in range(3, 6):
            cv2.imwrite(str(tmp_path / view.name / f"{index:05d}.png"), image(view))
    assert main(["calibrate", str(tmp_path), "--in-step", "--json"]) == 0
    told = check(capsys.readouterr().out, "calibrate")
    assert told["report"] and not told["warnings"] and told["calibration"] == str(tmp_path / "cameras_opencv.json")
    for camera, view in zip(told["cameras"], cameras, strict=True):
        assert (camera["name"], camera["offset_seconds"], camera["rate"]) == (view.name, 0, 1)
    capture = open_capture(tmp_path)
    assert rig_errors(capture.cameras, cameras)[0] < 1
    assert len(capture.shots) == 3 * len(cameras)
    with pytest.raises(FrogError, match="written beside them"):
        calibrate(tmp_path, Options(out=tmp_path / "elsewhere"), lambda *_: None, lambda: False)


# --- calibration and synchronization in turns: what is believed where they contradict each other


def clocks(offset: float, refusal: str | None = None) -> Synchronization:
    answer = synchronization(["a", "b"]).with_clocks({"a": (0.0, 1.0), "b": (offset, 1.0)})
    return replace(answer, refusal=refusal)


TOGETHER, LATER = clocks(0.0), clocks(0.5)
CONTRADICTION = clocks(0.5, "The films' lags contradict each other.")


class Solver:
    """Says from what its cameras come; refuses the background alone where it is told to."""

    def __init__(self, *, has_background: bool) -> None:
        self.has_background = has_background

    def __call__(self, films: Sequence[Film], count: int) -> Calibration:
        if count == 0 and not self.has_background:
            raise CalibrationRefused("The background shares too few points.")
        assert count in (0, TIMES)
        offsets = ", ".join(f"{film.offset:g}" for film in films)
        return Calibration((), source=f"what moves at {offsets}" if count else "the background")


def turns(*found: Synchronization, has_background: bool) -> tuple[Calibration, list[Film], Synchronization]:
    answers = iter(found)
    source = Source("features", Solver(has_background=has_background), needs_step=False)
    return alternated(source, films(*"ab"), lambda *_: next(answers))


def test_clocks_that_are_confirmed_are_used() -> None:
    calibration, timed, found = turns(LATER, LATER, has_background=True)
    assert calibration.source == "what moves at 0, 0.5"
    assert [film.offset for film in timed] == [0.0, 0.5] and found.clocks == LATER.clocks


@pytest.mark.parametrize("found", [[CONTRADICTION], [LATER, CONTRADICTION]])
def test_clocks_that_contradict_each_other_do_not_touch_the_cameras(found: list[Synchronization]) -> None:
    calibration, timed, kept = turns(*found, has_background=True)
    assert calibration.source == "the background"
    assert [film.offset for film in timed] == [0.0, 0.0] and kept.warnings == (CONTRADICTION.refusal,)


def test_films_taken_to_be_in_step_need_clocks_that_agree() -> None:
    calibration, _, _ = turns(TOGETHER, has_background=False)
    assert calibration.source == "what moves at 0, 0"
    with pytest.raises(CalibrationRefused) as refused:
        turns(CONTRADICTION, has_background=False)
    assert "shares too few points" in str(refused.value) and "contradict each other" in str(refused.value)
