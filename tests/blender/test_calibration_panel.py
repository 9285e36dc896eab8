"""From raw videos in the panel to a capture that can be trained from: what is said, and what the operators do."""

import json
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from support.builders import refused, refuses
from support.training_panel import finish, panel_says

from frog_blender.engine.capture.calibration import pipeline
from frog_blender.engine.capture.readers.pairing import Clock
from frog_blender.engine.capture.synchronization.films import CalibrationRefused
from frog_blender.engine.errors import FrogError
from frog_blender.engine.whole_progress import Standing
from frog_blender.tasks.background_task import Progress
from frog_blender.tasks.calibration import CalibrationTask
from frog_blender.tasks.clocks import read_clocks, write_clock
from frog_blender.ui import (
    capture_panel,
    capture_reading,
    capture_summary,
    rig_overlay,
    torch_environment,
    train_panel,
)

film = pytest.importorskip("support.synthetic_capture")
opencv_entry = pytest.importorskip("support.layouts.lists").opencv_entry


def write_cameras(folder: Path, name: str = "cameras_opencv.json", **changed) -> None:
    """What a calibration writes beside the videos: the true cameras."""
    cameras = [opencv_entry(camera, dist=[]) for camera in film.rig()]
    cameras[1]["offset"] = 0.02
    content = {"made_by": "frog calibrate", "cameras": cameras, "points": [[0, 0, 1]]} | changed
    (folder / name).write_text(json.dumps(content))


def calibrator_of(folder, gate=None):
    """Stands in for the pipeline, in the thread in which that runs; what is there already is kept."""

    def calibrate(progress, cancelled):
        progress(Standing("Refining the cameras", 0.4, 100.0))
        if gate is not None:
            gate.wait(20.0)
        kept = (folder / "cameras_opencv.json").is_file()
        cameras = folder / ("cameras_found.json" if kept else "cameras_opencv.json")
        write_cameras(folder, cameras.name)
        page, report = folder / "calibration_report.html", folder / "calibration_report.json"
        page.write_text("<p>Four cameras.</p>")
        warnings = ("cam03 sees little of what the others see.",)
        return SimpleNamespace(cameras=cameras, report=report, page=page, given_kept=kept, warnings=warnings)

    return calibrate


def drawn(panel=capture_panel.FROG_PT_capture):
    return panel_says(panel) or ""


@pytest.fixture
def calibrated(empty, raw):
    """A function that writes the cameras, which it returns as they lie there, and chooses the folder in the panel."""

    def show(**changed):
        write_cameras(raw, **changed)
        empty.frog.capture_folder = str(raw)
        return (raw / "cameras_opencv.json").read_bytes()

    return show


@pytest.fixture
def begin(monkeypatch):
    """A function that has the operator calibrate a folder by what stands in for the pipeline."""

    def task(folder, calibrator, **known):
        def calibrate(folder, options, *told):
            assert (options.in_step, options.layout == "standing") == (
                known.get("in_step", False),
                known.get("are_standing", False),
            )
            return calibrator(*told)

        bpy.context.scene.frog.capture_folder = str(folder)
        monkeypatch.setattr(pipeline, "calibrate", calibrate)
        monkeypatch.setattr(torch_environment, "calibration_needed", lambda: "")
        assert bpy.ops.frog.calibrate(**known) == {"FINISHED"}
        return CalibrationTask.current()

    return task


@pytest.mark.parametrize("known", [{}, {"in_step": True}, {"are_standing": True}])
def test_from_videos_to_a_capture(empty, raw, begin, known):
    task = begin(raw, calibrator_of(raw), **known)
    assert not finish(task).error
    said = drawn()
    assert "Camera positions: a calibration of the videos" in said and "4 cameras" in said, "it opens by itself"
    assert "Calibrated: cameras_opencv.json" in said and "cam03 sees little" in said and "wm.path_open" in said
    assert "frog.calibrate" not in said and "Roughly" in drawn(train_panel.FROG_PT_train)
    empty.frog.capture_folder = str(raw.parent)
    assert "Calibrated" not in drawn(), "that was another folder"


def test_a_capture_can_be_calibrated_again_and_keeps_what_was_given(raw, begin, calibrated):
    before = calibrated(made_by="somebody else")
    assert "frog.calibrate" not in drawn().split(), "it is not what is to be done next"
    assert "frog.calibrate" in drawn(capture_panel.FROG_PT_cameras).split()
    gate = threading.Event()
    task = begin(raw, calibrator_of(raw, gate))
    assert "frog.calibrate" not in drawn(capture_panel.FROG_PT_cameras).split(), "it runs"
    gate.set()
    assert not finish(task).error and (raw / "cameras_opencv.json").read_bytes() == before
    said = drawn()
    assert "Calibrated: cameras_found.json" in said and "What was found lies beside it." in said
    assert "frog.calibrate" in drawn(capture_panel.FROG_PT_cameras).split()


@pytest.mark.parametrize("kind", [CalibrationRefused, FrogError])
def test_a_refusal_says_what_to_film_and_leaves_the_button(empty, raw, begin, kind):
    files = sorted(raw.iterdir())

    def refuse(progress, cancelled):
        raise kind("cam00 and cam03 share nothing. Film a walk from one to the other.")

    assert finish(begin(raw, refuse)).is_refused == (kind is CalibrationRefused)
    said = drawn()
    assert "Film a walk from one to the other." in said and "frog.calibrate" in said.split()
    assert sorted(raw.iterdir()) == files


def test_the_operator_says_what_is_wrong(empty, raw, tmp_path):
    refuses("No capture is selected", bpy.ops.frog.calibrate)
    empty.frog.capture_folder = str(tmp_path / "nowhere")
    refuses("found no such folder", bpy.ops.frog.calibrate)


def test_a_cancelled_calibration(empty, raw, begin):
    def calibrate(progress, cancelled):
        while not cancelled():
            pass
        raise RuntimeError("ended")

    task = begin(raw, calibrate)
    task.progress = Progress("Matching images", whole=Standing("Matching images", 0.4, 200.0))
    said = drawn()
    assert "Matching images About 3 minutes left frog.cancel_calibration" in said
    assert "frog.calibrate" not in said.split()
    empty.frog.capture_folder = str(raw.parent)
    assert "Calibrating raw" in drawn()
    empty.frog.capture_folder = str(raw)
    assert bpy.ops.frog.cancel_calibration() == {"FINISHED"}
    assert "Cancelling frog.cancel_calibration" in drawn()
    finish(task)
    assert "Cancelled. The next calibration continues" in drawn() and "frog.calibrate" in drawn()
    assert not bpy.ops.frog.cancel_calibration.poll()


def test_clocks_are_listed_and_corrected(raw, calibrated):
    calibrated()
    said = drawn(capture_panel.FROG_PT_synchronization)
    assert "cam01 +0.020 s frog.edit_clock" in said and "cam00 +0.000 s" in said and "wm.path_open" not in said
    (raw / "calibration_report.html").write_text("curves")
    assert "wm.path_open" in drawn(capture_panel.FROG_PT_synchronization)
    assert bpy.ops.frog.edit_clock(camera="cam02", offset=0.1, rate=1.0005) == {"FINISHED"}
    assert "cam02 +0.100 s, x 1.00050" in drawn(capture_panel.FROG_PT_synchronization)
    content = json.loads((raw / "cameras_opencv.json").read_text())
    assert content["points"] == [[0, 0, 1]] and content["cameras"][1]["offset"] == 0.02, "nothing else has changed"
    changed = {shot.offset for shot in capture_summary.known(str(raw)).capture.shots}
    assert changed != {0.0}, "the capture's times follow"
    refuses("no camera cam09", bpy.ops.frog.edit_clock, camera="cam09")


def test_a_given_calibration_is_not_changed(raw, calibrated):
    before = calibrated(made_by="somebody else")
    said = drawn(capture_panel.FROG_PT_synchronization)
    assert "was given" in said and "frog.edit_clock" not in said
    refuses("was given", bpy.ops.frog.edit_clock, camera="cam02", offset=0.1)
    assert (raw / "cameras_opencv.json").read_bytes() == before
    (raw / "cameras_found.json").write_text("{}")
    capture_reading.read(str(raw))
    assert "beside it in cameras_found.json" in drawn(capture_panel.FROG_PT_synchronization)


def test_found_cameras_become_the_ones_in_use(raw, calibrated):
    given = calibrated(made_by="somebody else")
    assert not bpy.ops.frog.use_found_cameras.poll()
    assert "use_found" not in drawn(capture_panel.FROG_PT_cameras)
    calibration = json.loads(given) | {"made_by": "frog calibrate"}
    calibration["cameras"][1]["offset"] = 0.1
    (raw / "cameras_found.json").write_text(json.dumps(calibration))
    capture_reading.read(str(raw))
    said = drawn(capture_panel.FROG_PT_cameras)
    assert "frog.use_found_cameras" in said
    before = {shot.offset for shot in capture_summary.known(str(raw)).capture.shots}
    assert bpy.ops.frog.use_found_cameras() == {"FINISHED"}
    assert {shot.offset for shot in capture_summary.known(str(raw)).capture.shots} != before, "it is opened anew"
    assert "cam01 +0.100 s frog.edit_clock" in drawn(capture_panel.FROG_PT_synchronization)
    assert "frog.use_found_cameras" not in drawn(capture_panel.FROG_PT_cameras)
    assert (raw / "cameras_given.json").read_bytes() == given
    (raw / "cameras_opencv.json").write_text("{}")
    bpy.context.scene.frog.capture_folder = str(raw)
    assert "no list of cameras" in capture_summary.known(str(raw)).error
    assert bpy.ops.frog.use_found_cameras() == {"FINISHED"}, "one that cannot be read gives way"
    assert not bpy.ops.frog.use_found_cameras.poll() and capture_summary.known(str(raw)).capture is not None
    bpy.context.scene.frog.capture_folder = ""
    assert not bpy.ops.frog.use_found_cameras.poll()


@pytest.mark.parametrize("content", ["[]", '{"cameras": [4, 5]}', '{"cameras": [{"name": "a", "offset": "b"}]}'])
def test_clocks_that_cannot_be_read_or_written_are_one_error(raw, calibrated, content):
    (raw / "cameras_opencv.json").write_text(content)
    refused(r"cameras_opencv\.json", read_clocks, raw)
    before = calibrated()
    for clock in (Clock(float("nan")), Clock(0.0, 0.0)):
        refused("expected", write_clock, raw, "cam01", clock)
    assert (raw / "cameras_opencv.json").read_bytes() == before


def test_the_drawn_rig_looks_as_the_cameras_do():
    cameras = film.rig()
    for camera, (centre, *corners) in zip(cameras, rig_overlay.corners_of(cameras), strict=True):
        np.testing.assert_allclose(centre, camera.center, atol=1e-9)
        pixels, depths = camera.project(np.array(corners[:4]))
        width, height = camera.width, camera.height
        assert (depths > 0).all()
        np.testing.assert_allclose(pixels, [[0, 0], [width, 0], [width, height], [0, height]], atol=1e-6)


def test_the_rig_is_drawn_until_a_scene_is_imported(empty, raw, calibrated, static_rig):
    calibrated()
    assert rig_overlay.shown_capture(empty) is capture_summary.known(str(raw)).capture
    empty.frog.show_rig = False
    assert rig_overlay.shown_capture(empty) is None
    empty.frog.show_rig = True
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    assert rig_overlay.shown_capture(empty) is None
