"""What a calibration keeps, takes, gives back, reports in lines and draws on its page."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frog_blender.cli.info_command import _checked
from frog_blender.cli.main import main
from frog_blender.engine.capture.calibration import camera_files
from frog_blender.engine.capture.calibration.camera_files import write_cameras
from frog_blender.engine.capture.calibration.checks import check_places
from frog_blender.engine.capture.calibration.model import (
    CalibratedCamera,
    Calibration,
    CameraSupport,
    Lens,
    MovingCamera,
)
from frog_blender.engine.capture.calibration.report import (
    REPORT,
    from_above,
    report_lines,
    write_moving_report,
    write_report,
)
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import layout_of, open_capture
from frog_blender.engine.capture.synchronization.films import Film
from frog_blender.engine.capture.synchronization.pairs import Curve
from frog_blender.engine.capture.synchronization.synchronization import CameraClock, Synchronization
from frog_blender.engine.capture.video import read_facts
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.work_folder import WorkFolder

from .rigs import WIDE, looking
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


def test_two_films_of_one_camera_are_refused(tmp_path: Path) -> None:
    calibration, _ = calibrated(tmp_path)
    check_places(calibration)
    one, *others = calibration.cameras
    again = replace(one, camera=replace(one.camera, name="again"))
    with pytest.raises(FrogError, match=f"{one.camera.name} and again stand at one place"):
        check_places(replace(calibration, cameras=(one, *others, again)))


def test_the_result_is_a_capture(tmp_path: Path) -> None:
    calibration, films = calibrated(tmp_path, k1=-0.1)
    assert camera_files.write_cameras(tmp_path, calibration, films).name == "cameras_opencv.json"
    capture = open_capture(tmp_path)
    assert capture.format == "calibrated_videos" and capture.frame_count == 4
    for camera, true in zip(capture.cameras, rig(), strict=False):
        assert np.allclose(camera.world_to_camera, true.world_to_camera, atol=1e-9)
        assert np.allclose(camera.intrinsics, true.intrinsics)
    assert camera_files.write_cameras(tmp_path, calibration, films).name == "cameras_opencv.json"
    assert capture.distortions[0] is not None and capture.distortions[0].coefficients[0] == -0.1


def test_a_given_calibration_is_left_as_it_is(tmp_path: Path) -> None:
    calibration, films = calibrated(tmp_path)
    given = tmp_path / "cameras_opencv.json"
    given.write_text('{"mine": 1}')
    found = camera_files.write_cameras(tmp_path, calibration, films)
    assert found.name == "cameras_found.json" and given.read_text() == '{"mine": 1}'
    assert camera_files.write_cameras(tmp_path, calibration, films) == found, "the same is not written twice"
    found.write_text("corrected by hand")
    assert camera_files.write_cameras(tmp_path, calibration, films).name == "cameras_found_2.json"
    assert found.read_text() == "corrected by hand"


def test_elsewhere_it_names_its_videos_and_their_clocks(tmp_path: Path) -> None:
    (tmp_path / "films").mkdir()
    calibration, films = calibrated(tmp_path / "films")
    films[1] = Film(films[1].name, films[1].path, films[1].facts, 0.25, 1.001)
    path = camera_files.write_cameras(tmp_path / "out" / "deep", calibration, films)
    entries = json.loads(path.read_text())["cameras"]
    assert entries[0]["video"] == "../../films/cam0.mp4" and "offset" not in entries[0]
    assert (entries[1]["offset"], entries[1]["rate"]) == (0.25, 1.001)


def test_a_capture_in_a_folder_below_is_no_calibration_of_this_one(tmp_path: Path) -> None:
    below = tmp_path / "test shoot"
    below.mkdir()
    calibration, films = calibrated(below)
    camera_files.write_cameras(below, calibration, films)
    assert camera_files.is_calibrated(below) and not camera_files.is_calibrated(tmp_path)


# --- found and given


def contents(folder: Path) -> set[bytes]:
    return {path.read_bytes() for path in folder.iterdir()}


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.suffix != ".mp4"}


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """A given calibration, and another one that was found beside it."""
    calibration, films = calibrated(tmp_path)
    (tmp_path / "cameras_opencv.json").write_text('{"mine": 1}')
    assert camera_files.write_cameras(tmp_path, calibration, films).name == "cameras_found.json"
    return tmp_path


def test_what_was_found_is_used_and_nothing_is_lost(both: Path) -> None:
    before = contents(both)
    found = (both / "cameras_found.json").read_bytes()
    assert camera_files.found_beside(both) == both / "cameras_found.json"
    used, kept = camera_files.use_found(both)
    assert used == both / "cameras_opencv.json" and used.read_bytes() == found
    assert kept == [both / "cameras_given.json"] and kept[0].read_text() == '{"mine": 1}'
    assert camera_files.found_beside(both) is None
    kept[0].replace(used)
    assert camera_files.found_beside(both) == both / "cameras_found.json"
    (both / "cameras_given.json").write_text("another given one")
    _, kept = camera_files.use_found(both)
    assert kept == [both / "cameras_given_2.json"] and contents(both) == before | {b"another given one"}


def test_the_newest_found_one_is_taken(both: Path) -> None:
    newer = both / "cameras_found_2.json"
    newer.write_text("newer")
    (both / "cameras_found_old.json").write_text("somebody's own name")
    os.utime(both / "cameras_found.json", (1, 1))
    assert camera_files.found_beside(both) == newer


def test_a_calibration_of_another_kind_is_set_aside(tmp_path: Path) -> None:
    """Readers would take it sooner."""
    calibration, films = calibrated(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 17)))
    given = (tmp_path / "poses_bounds.npy").read_bytes()
    camera_files.write_cameras(tmp_path, calibration, films)
    assert layout_of(tmp_path) == "n3dv" and files(tmp_path) == {"cameras_found.json", "poses_bounds.npy"}
    used, kept = camera_files.use_found(tmp_path)
    assert layout_of(tmp_path) == "calibrated_videos" and used.name == "cameras_opencv.json"
    assert kept == [tmp_path / "poses_bounds_given.npy"] and kept[0].read_bytes() == given


def test_a_moving_camera_s_list(tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text("given")
    (tmp_path / "transforms_found.json").write_text("found")
    used, _ = camera_files.use_found(tmp_path)
    assert used.name == "transforms.json" and used.read_text() == "found"
    assert (tmp_path / "transforms_given.json").read_text() == "given"


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_what_ends_it_early_leaves_one_in_use(tmp_path: Path, broken: int, monkeypatch: pytest.MonkeyPatch) -> None:
    calibration, films = calibrated(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 17)))
    (tmp_path / "cameras_opencv.json").write_text('{"mine": 1}')
    found = camera_files.write_cameras(tmp_path, calibration, films)
    before, whole, written = contents(tmp_path), camera_files.write_atomically, []

    def write(path: Path, content: bytes) -> None:
        written.append(path)
        if len(written) > broken:
            raise FrogError(f"{path}: the disk is full.")
        whole(path, content)

    monkeypatch.setattr(camera_files, "write_atomically", write)
    with pytest.raises(FrogError, match="the disk is full"):
        camera_files.use_found(tmp_path)
    assert contents(tmp_path) == before and layout_of(tmp_path) == "n3dv"
    assert (tmp_path / "cameras_opencv.json").read_bytes() in (b'{"mine": 1}', found.read_bytes())


def test_the_command_line_chooses(both: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(both), "--use-found"]) == 0
    said = capsys.readouterr().out
    assert "cameras_opencv.json: in use now" in said and "cameras_given.json: what was in use before" in said
    assert main(["calibrate", str(both), "--use-found"]) == 2
    assert "no cameras_found.json that is not in use" in capsys.readouterr().err


@pytest.mark.parametrize("other", [{"a": np.arange(4)}, {"a": np.arange(3.0)}, {"b": np.arange(3)}, {}])
def test_other_arrays_are_not_loaded(tmp_path: Path, other: dict[str, np.ndarray]) -> None:
    work = WorkFolder(tmp_path)
    path = work.keep("stage", "0", {"a": np.arange(3)})
    assert np.array_equal((work.load("stage", "0") or other)["a"], [0, 1, 2])
    with np.load(path) as kept:
        seal = kept["seal"]
    np.savez(path, **other, seal=seal)
    assert work.load("stage", "0") is None
    np.savez(path, **other)
    assert work.load("stage", "0") is None and work.load("stage", "1") is None


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
