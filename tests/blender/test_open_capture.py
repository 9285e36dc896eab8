"""Dropped videos and chosen folders become the capture to train from, or one sentence."""

import threading
from functools import partial
from itertools import product

import bpy
import pytest
from support.blender_windows import in_window
from support.builders import refuses
from support.filmed_scene import NAMES, rig, still
from support.layouts.files import write_image
from support.layouts.lists import opencv_entry, write_opencv
from support.training_panel import panel_says

from frog_blender.operators.open_capture import FROG_OT_drop_videos
from frog_blender.tasks import background_task
from frog_blender.tasks.training_request import request_of
from frog_blender.ui import capture_panel, capture_reading, capture_summary
from frog_blender.ui.capture_reading import CaptureReading


@pytest.fixture
def capture(tmp_path):
    pytest.importorskip("cv2")
    return pytest.importorskip("support.synthetic_capture").write_capture(tmp_path / "capture")


@pytest.fixture
def drawn_panel(empty):
    """A function that gives what the panel Capture says."""
    return partial(panel_says, capture_panel.FROG_PT_capture)


def drop(folder, *names):
    return bpy.ops.frog.drop_videos(directory=f"{folder}/", files=[{"name": name} for name in names])


def test_dropped_raw_videos_are_chosen_to_be_calibrated(empty, capture):
    (capture / "poses_bounds.npy").unlink()
    assert drop(capture, "cam01.mp4", "cam02.mp4") == {"FINISHED"}
    assert empty.frog.capture_folder == str(capture) and empty.frog.output_path == f"{capture}.frog"
    summary = capture_summary.known(str(capture))
    assert summary.raw_footage == "4 videos" and summary.capture is None and not summary.error
    assert "4 videos without a calibration" in " ".join(summary.lines)


def test_a_calibration_that_does_not_fit_says_so(empty, capture):
    refuses("Found no video", drop, capture)
    (capture / "poses_bounds.npy").write_bytes(b"no numbers")
    refuses(r"poses_bounds\.npy", drop, capture, "cam01.mp4")
    assert not empty.frog.capture_folder


def test_a_folder_from_the_import_menu(empty, capture, tmp_path):
    assert bpy.ops.import_scene.frog_capture(directory=f"{capture}/") == {"FINISHED"}
    assert empty.frog.capture_folder.rstrip("/") == str(capture)
    assert capture_summary.known(bpy.path.abspath(empty.frog.capture_folder)).capture is not None
    refuses("nowhere", bpy.ops.import_scene.frog_capture, directory=str(tmp_path / "nowhere"))
    assert empty.frog.capture_folder.rstrip("/") == str(capture)


def test_names_with_two_readings_are_asked_for_in_the_panel(empty, tmp_path, drawn_panel):
    for camera, time in product(range(4), range(4)):
        write_image(tmp_path / f"{time}" / f"{camera}.png", still(NAMES[camera], time))
    write_opencv(tmp_path, [opencv_entry(camera) | {"name": f"{index}"} for index, camera in enumerate(rig())])
    empty.frog.capture_folder = str(tmp_path)
    assert "if folders are moments (--layout moments)" in drawn_panel() and "layout" in drawn_panel()
    empty.frog.layout = "moments"
    (shot, *_) = capture_summary.known(str(tmp_path)).capture.shots
    assert shot.path == tmp_path / "0" / "0.png" and "4 cameras" in drawn_panel()
    assert request_of(empty.frog).options.layout == "moments"
    empty.frog.capture_folder = ""
    assert empty.frog.layout == "auto"


@pytest.fixture
def may_go_on(monkeypatch):
    """Until it is set, folders are being read."""
    read, may_go_on = capture_summary.read, threading.Event()
    monkeypatch.setattr(capture_summary, "read", lambda *told: may_go_on.wait(20.0) and read(*told))
    yield may_go_on
    may_go_on.set()


def test_a_window_does_not_wait_until_a_folder_is_read(empty, capture, drawn_panel, may_go_on, monkeypatch):
    monkeypatch.setattr(capture_reading, "read", capture_reading.read_beside)
    empty.frog.capture_folder = str(capture)
    assert capture_reading.is_reading(str(capture)) and capture_summary.known(str(capture)) is None
    assert "Reading the capture" in drawn_panel() and "frog.inspect_capture" not in drawn_panel()
    assert background_task.tick() is not None, "it is called again"
    may_go_on.set()
    assert CaptureReading.current(str(capture)).join(20.0)
    assert background_task.tick() is None
    assert capture_summary.known(str(capture)).capture is not None
    assert "4 cameras" in drawn_panel() and "Reading" not in drawn_panel()


@pytest.fixture
def dropping(empty, capture, may_go_on):
    """Videos that were dropped into a window, whose folder is being read."""
    with in_window(FROG_OT_drop_videos) as window:
        assert drop(capture, "cam01.mp4") == {"RUNNING_MODAL"}
        yield window


def test_a_window_goes_on_while_dropped_videos_are_read(empty, capture, dropping, may_go_on):
    assert dropping.send(times=2) == {"PASS_THROUGH"} and not empty.frog.capture_folder
    may_go_on.set()
    assert dropping.send_until() == {"FINISHED"}
    assert empty.frog.capture_folder == str(capture)
    ((kind, sentence),) = dropping.said
    assert kind == "INFO" and "4 cameras" in sentence


def test_a_drop_that_is_stopped_changes_nothing(empty, dropping):
    assert dropping.send("ESC", "PRESS") == {"CANCELLED"} and not empty.frog.capture_folder
    assert dropping.said == [("INFO", "No capture was chosen.")]
