"""Calibration in the background by real processes, whatever becomes of those."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial

import bpy
import pytest
from support.training_panel import finish

from frog_blender.engine.capture.synchronization.run import CHILD, CalibrationRefused
from frog_blender.engine.errors import FrogError
from frog_blender.tasks.calibration import CalibrationTask


def started(folder, calibrator=None):
    """A calibration by the real process, which reads its request in a folder."""
    task = CalibrationTask(folder)
    task.work = lambda: (calibrator or partial(CHILD.run, folder))(task.tell, task.stopped.is_set)
    return task.start()


@pytest.mark.parametrize("kind", [CalibrationRefused, FrogError])
def test_a_refusal_is_told_from_a_failure(addon, tmp_path, kind):
    def fails(progress, stopped):
        raise kind("Film a walk.")

    task = finish(started(tmp_path, fails))
    assert task.error == "Film a walk." and task.is_refused == (kind is CalibrationRefused)


def test_a_calibrator_that_crashes_is_one_sentence(addon, tmp_path):
    """It finds no request and ends with an error."""
    task = finish(started(tmp_path))
    assert task.error.startswith("The calibration's process ended with status 1 (") and task.result is None
    assert not list(tmp_path.iterdir()), "nothing was written"


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL and makes a FIFO")
@pytest.mark.parametrize("killed", [True, False], ids=["killed", "cancelled"])
def test_a_calibrator_that_hears_nothing_is_ended_and_leaves_blender_as_it_was(empty, tmp_path, killed):
    """As one that computes, such as a bundle adjustment; or the system ends it, when memory runs out."""
    objects = len(bpy.data.objects)
    os.mkfifo(tmp_path / "request.json")  # the process waits at it
    task = started(tmp_path)
    deadline = time.monotonic() + 60
    while not (children := children_of(os.getpid())) and time.monotonic() < deadline:
        time.sleep(0.01)
    for child in children if killed else ():
        os.kill(child, signal.SIGKILL)
    if not killed:
        task.cancel()
    finish(task)
    assert task.result is None and len(bpy.data.objects) == objects and not children_of(os.getpid())
    assert ("was ended by signal 9" in task.error) == killed and task.is_cancelled != killed


def children_of(process):
    """Child processes that run a task."""
    listed = subprocess.run(["ps", "-ww", "-eo", "pid,ppid,args"], capture_output=True, text=True, check=True).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()[1:]]
    return [int(row[0]) for row in rows if int(row[1]) == process and "io.child_process" in row[2]]
