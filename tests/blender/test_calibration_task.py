"""Calibration in the background: progress arrives, and every end is a plain state."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from frog_blender.engine.capture.calibration.calibration import CalibrationRefused
from frog_blender.engine.capture.calibration.pipeline import Outcome
from frog_blender.engine.errors import FrogError
from frog_blender.tasks import calibration
from frog_blender.tasks.background_task import TIMER_SECONDS


def outcome(folder, **changed):
    """What a calibration of a folder might have written."""
    values = {
        "cameras": folder / "cameras_opencv.json",
        "report": folder / "calibration_report.json",
        "page": folder / "calibration_report.html",
        "given_kept": False,
        "warnings": (),
    }
    return SimpleNamespace(**values | changed)


def finish(task):
    """Pump until the calibration ends, as a headless run does."""
    assert task.join(20.0)
    while task.pump():
        pass
    assert not task.state.running
    return task.state


def raising(error):
    def calibrator(progress, cancelled):
        raise error

    return calibrator


def test_the_stand_in_has_what_the_pipeline_gives():
    assert set(vars(outcome(Path()))) == set(Outcome.__dataclass_fields__)


def test_progress_becomes_state(addon, tmp_path):
    gate = threading.Event()
    finished = []

    def calibrator(progress, cancelled):
        progress("films", 3, 4)
        gate.wait(20.0)
        return outcome(tmp_path)

    task = calibration.CalibrationTask(tmp_path, calibrator, lambda *given: finished.append(given)).start()
    while not task.pump():
        pass
    assert task.state.running and task.state.doing == "Films: 3 of 4" and task.state.fraction == 0.75
    assert task.pump() == 0, "it does not wait"
    gate.set()
    state = finish(task)
    assert not state.error and not state.cancelled
    assert finished == [(tmp_path, state.outcome)] and state.outcome.cameras == tmp_path / "cameras_opencv.json"


@pytest.mark.parametrize(("done", "total", "fraction"), [(0, 0, 0.0), (5, 0, 0.0), (9, 4, 1.0), (-1, 4, 0.0)])
def test_no_progress_is_out_of_range(addon, tmp_path, done, total, fraction):
    def calibrator(progress, cancelled):
        progress("images", done, total)
        return outcome(tmp_path)

    assert finish(calibration.CalibrationTask(tmp_path, calibrator).start()).fraction == fraction


def test_a_refusal_is_told_from_a_failure(addon, tmp_path):
    refused = finish(calibration.CalibrationTask(tmp_path, raising(CalibrationRefused("Film a walk."))).start())
    assert refused.error == "Film a walk." and refused.is_refused and refused.outcome is None
    failed = finish(calibration.CalibrationTask(tmp_path, raising(FrogError("No video."))).start())
    assert failed.error == "No video." and not failed.is_refused


def test_an_unexpected_error_is_one_sentence(addon, tmp_path, capfd):
    state = finish(calibration.CalibrationTask(tmp_path, raising(ZeroDivisionError("a\nb"))).start())
    assert state.error == "Calibration stopped on an unexpected ZeroDivisionError: a b."
    assert "Traceback" in capfd.readouterr().err


def test_cancel_reaches_the_worker_whatever_it_raises(addon, tmp_path):
    class Ended(Exception):
        pass

    def calibrator(progress, cancelled):
        while not cancelled():
            pass
        raise Ended

    task = calibration.CalibrationTask(tmp_path, calibrator, lambda *_: pytest.fail("nothing was written")).start()
    task.cancel()
    assert task.is_stopping
    state = finish(task)
    assert state.cancelled and not state.error and not task.is_stopping


def test_what_was_written_in_time_counts_though_it_was_cancelled(addon, tmp_path):
    def calibrator(progress, cancelled):
        while not cancelled():
            pass
        return outcome(tmp_path)

    task = calibration.CalibrationTask(tmp_path, calibrator).start()
    task.cancel()
    state = finish(task)
    assert state.outcome is not None and not state.cancelled


def test_a_result_that_cannot_be_opened_says_so(addon, tmp_path):
    def refuse(folder, result):
        raise FrogError("It does not fit.")

    def fail(folder, result):
        raise KeyError("x")

    done = lambda progress, cancelled: outcome(tmp_path)  # noqa: E731
    assert finish(calibration.CalibrationTask(tmp_path, done, refuse).start()).error == "It does not fit."
    state = finish(calibration.CalibrationTask(tmp_path, done, fail).start())
    assert "written, but the capture could not be opened" in state.error and state.outcome is not None


def test_one_at_a_time_and_none_outlives_the_add_on(addon, tmp_path):
    ended = threading.Event()

    def calibrator(progress, cancelled):
        while not cancelled():
            pass
        ended.set()

    calibration.begin(tmp_path, calibrator)
    try:
        assert calibration.is_running() and bpy.app.timers.is_registered(calibration.tick)
        with pytest.raises(FrogError, match="already running"):
            calibration.begin(tmp_path, calibrator)
    finally:
        addon.unregister()
        addon.register()
    assert ended.is_set() and calibration.current() is None and not bpy.app.timers.is_registered(calibration.tick)


def test_the_timer_ends_with_the_calibration(addon, tmp_path):
    task = calibration.begin(tmp_path, lambda progress, cancelled: outcome(tmp_path))
    try:
        assert task.join(20.0)
        while (seconds := calibration.tick()) is not None:
            assert seconds == TIMER_SECONDS
        assert not task.state.running and task.state.outcome is not None
    finally:
        calibration.stop()
        calibration.set_current(None)


def test_a_calibrator_that_crashes_is_one_sentence(addon, tmp_path):
    """The real process, which finds no request and ends with an error."""
    from frog_blender.engine.capture.calibration.child_process import run

    task = calibration.CalibrationTask(
        tmp_path, lambda progress, cancelled: run("standing", tmp_path, progress, cancelled)
    )
    state = finish(task.start())
    assert state.error.startswith("The calibration's process ended with status 1 (") and state.outcome is None
    assert not list(tmp_path.iterdir()), "nothing was written"


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL")
def test_a_killed_calibrator_leaves_blender_as_it_was(empty, tmp_path):
    """As the system does when memory runs out."""
    from frog_blender.engine.capture.calibration.child_process import run

    objects = len(bpy.data.objects)
    os.mkfifo(tmp_path / "request.json")  # the real process waits at it
    task = calibration.CalibrationTask(
        tmp_path, lambda progress, cancelled: run("standing", tmp_path, progress, cancelled)
    )
    task.start()
    deadline = time.monotonic() + 60
    while not (children := children_of(os.getpid(), "io.child_process")) and time.monotonic() < deadline:
        time.sleep(0.01)
    for child in children:
        os.kill(child, signal.SIGKILL)
    state = finish(task)
    assert "was ended by signal 9" in state.error and state.outcome is None and len(bpy.data.objects) == objects


@pytest.mark.skipif(sys.platform == "win32", reason="makes a FIFO")
def test_a_cancelled_calibration_ends_its_process(empty, tmp_path):
    """Though that one computes, as a bundle adjustment does, and hears nothing."""
    from frog_blender.engine.capture.calibration.child_process import run

    os.mkfifo(tmp_path / "request.json")
    task = calibration.CalibrationTask(
        tmp_path, lambda progress, cancelled: run("standing", tmp_path, progress, cancelled)
    )
    task.start()
    deadline = time.monotonic() + 60
    while not children_of(os.getpid(), "io.child_process") and time.monotonic() < deadline:
        time.sleep(0.01)
    task.cancel()
    state = finish(task)
    assert state.cancelled and not state.error and not children_of(os.getpid(), "io.child_process")


def children_of(process, word):
    """Child processes whose command holds a word."""
    listed = subprocess.run(["ps", "-ww", "-eo", "pid,ppid,args"], capture_output=True, text=True, check=True).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()[1:]]
    return [int(row[0]) for row in rows if int(row[1]) == process and word in row[2]]
