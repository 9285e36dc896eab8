"""Found cameras take the place of given ones and give it back; every content that was there is there."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from frog_blender.cli.main import main
from frog_blender.engine.capture.calibration import camera_files
from frog_blender.engine.capture.calibration.camera_files import (
    found_beside,
    given_beside,
    use_found,
    use_given,
    write_cameras,
)
from frog_blender.engine.capture.readers import layout_of
from frog_blender.engine.errors import FrogError

from .test_result_files import calibrated


def contents(folder: Path) -> set[bytes]:
    return {path.read_bytes() for path in folder.iterdir()}


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.suffix != ".mp4"}


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """A given calibration, and another one that was found beside it."""
    calibration, films = calibrated(tmp_path)
    (tmp_path / "cameras_opencv.json").write_text('{"mine": 1}')
    assert write_cameras(tmp_path, calibration, films).name == "cameras_found.json"
    return tmp_path


def test_there_and_back(both: Path) -> None:
    before = contents(both)
    found = (both / "cameras_found.json").read_bytes()
    assert found_beside(both) == both / "cameras_found.json" and given_beside(both) is None
    used, kept = use_found(both)
    assert used == both / "cameras_opencv.json" and used.read_bytes() == found
    assert kept == [both / "cameras_given.json"] and kept[0].read_text() == '{"mine": 1}'
    assert found_beside(both) is None and given_beside(both) == kept[0]
    assert use_given(both).read_text() == '{"mine": 1}'
    assert found_beside(both) == both / "cameras_found.json" and given_beside(both) is None
    for _ in range(2):
        use_found(both)
        use_given(both)
    assert contents(both) == before
    assert files(both) == {"cameras_opencv.json", "cameras_found.json", "cameras_given.json"}


def test_what_was_corrected_meanwhile_is_kept_too(both: Path) -> None:
    used, _ = use_found(both)
    used.write_text("corrected")
    (both / "cameras_given.json").write_text("another given one")
    use_given(both)
    assert (both / "cameras_found_2.json").read_text() == "corrected"
    before = contents(both)
    (both / "cameras_opencv.json").write_text("a third one")
    used, kept = use_found(both)
    assert kept == [both / "cameras_given_2.json"] and kept[0].read_text() == "a third one"
    assert contents(both) == before | {b"a third one"}


def test_the_newest_found_one_is_taken(both: Path) -> None:
    newer = both / "cameras_found_2.json"
    newer.write_text("newer")
    (both / "cameras_found_old.json").write_text("somebody's own name")
    os.utime(both / "cameras_found.json", (1, 1))
    assert found_beside(both) == newer


def test_a_calibration_of_another_kind_is_set_aside(tmp_path: Path) -> None:
    """Readers would take it sooner."""
    calibration, films = calibrated(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 17)))
    given = (tmp_path / "poses_bounds.npy").read_bytes()
    write_cameras(tmp_path, calibration, films)
    assert layout_of(tmp_path) == "n3dv"
    used, kept = use_found(tmp_path)
    assert layout_of(tmp_path) == "calibrated_videos" and used.name == "cameras_opencv.json"
    assert kept == [tmp_path / "poses_bounds_given.npy"] and kept[0].read_bytes() == given
    assert use_given(tmp_path).read_bytes() == given
    assert layout_of(tmp_path) == "n3dv" and found_beside(tmp_path) == tmp_path / "cameras_found.json"
    use_found(tmp_path)
    assert layout_of(tmp_path) == "calibrated_videos"


def test_a_moving_camera_s_list(tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text("given")
    (tmp_path / "transforms_found.json").write_text("found")
    used, _ = use_found(tmp_path)
    assert used.name == "transforms.json" and used.read_text() == "found"
    assert use_given(tmp_path).read_text() == "given"
    assert (tmp_path / "transforms_found.json").read_text() == "found"


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_what_ends_it_early_leaves_one_in_use(tmp_path: Path, broken: int, monkeypatch: pytest.MonkeyPatch) -> None:
    calibration, films = calibrated(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 17)))
    (tmp_path / "cameras_opencv.json").write_text('{"mine": 1}')
    found = write_cameras(tmp_path, calibration, films)
    before, whole, written = contents(tmp_path), camera_files.write_atomically, []

    def write(path: Path, content: bytes) -> None:
        written.append(path)
        if len(written) > broken:
            raise FrogError(f"{path}: the disk is full.")
        whole(path, content)

    monkeypatch.setattr(camera_files, "write_atomically", write)
    with pytest.raises(FrogError, match="the disk is full"):
        use_found(tmp_path)
    assert contents(tmp_path) == before and layout_of(tmp_path) == "n3dv"
    assert (tmp_path / "cameras_opencv.json").read_bytes() in (b'{"mine": 1}', found.read_bytes())


def test_nothing_to_choose_is_said(tmp_path: Path) -> None:
    with pytest.raises(FrogError, match=r"no cameras_found\.json that is not in use"):
        use_found(tmp_path)
    with pytest.raises(FrogError, match="no calibration that was set aside"):
        use_given(tmp_path)


def test_the_command_line_chooses(both: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(both), "--use-found"]) == 0
    said = capsys.readouterr().out
    assert "cameras_opencv.json: in use now" in said and "cameras_given.json: what was in use before" in said
    assert main(["calibrate", str(both), "--use-given"]) == 0
    assert "in use again" in capsys.readouterr().out
    assert (both / "cameras_opencv.json").read_text() == '{"mine": 1}'
    assert main(["calibrate", str(both), "--use-given"]) != 0
