"""``frog calibrate`` from videos on disk to a capture that opens."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from frog_blender.cli.main import main
from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.child_process import Stopped

from .rigs import rig_errors
from .walls import film, image, rig

pytest.importorskip("pycolmap")


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("footage")
    for each in rig()[:4]:
        film(folder / f"{each.name}.mp4", [image(each)] * 3)
    return folder


def test_videos_become_a_capture(footage: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(footage), "--in-step"]) == 0
    assert "cameras_opencv.json: the cameras" in capsys.readouterr().out
    capture = open_capture(footage)
    assert rig_errors(capture.cameras, rig()[:4])[0] < 1
    report = json.loads((footage / "calibration_report.json").read_text())
    assert [each["name"] for each in report["cameras"]] == [each.name for each in rig()[:4]]
    assert len(report["pairs"]) == 6
    page = (footage / "calibration_report.html").read_text()
    assert page.count("<svg") == 1 and page.count("data:image/jpeg") == 4
    # A second run finds the same, and overwrites nothing.
    before = (footage / "cameras_opencv.json").read_bytes()
    assert main(["calibrate", str(footage), "--in-step"]) == 0
    assert (footage / "cameras_opencv.json").read_bytes() == before


def test_folders_of_frames_become_a_capture(tmp_path: Path) -> None:
    cameras = rig()[1:4]
    for each in cameras:
        (tmp_path / each.name).mkdir()
        for number in range(3, 6):
            cv2.imwrite(str(tmp_path / each.name / f"{number:05d}.png"), image(each))
    assert main(["calibrate", str(tmp_path), "--in-step"]) == 0
    capture = open_capture(tmp_path)
    assert rig_errors(capture.cameras, cameras)[0] < 1
    assert len(capture.shots) == 3 * len(cameras)
    with pytest.raises(FrogError, match="written beside them"):
        calibrate(tmp_path, Options(out=tmp_path / "elsewhere"), lambda *_: None, lambda: False)


def test_it_can_be_cancelled_at_once(footage: Path, tmp_path: Path) -> None:
    with pytest.raises(Stopped):
        calibrate(footage, Options(out=tmp_path, in_step=True), lambda *_: None, lambda: True)
    assert not list(tmp_path.glob("*.json"))


def test_clocks_are_checked(footage: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(footage), "--clock", "cam0=soon"]) == 1
    assert "expected CAMERA=SECONDS" in capsys.readouterr().err
    assert main(["calibrate", str(footage / "nowhere")]) == 1
    assert "there is no such folder" in capsys.readouterr().err
