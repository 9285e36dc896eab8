"""A training that is held: it waits without working, goes on, and ends whenever it is asked to."""

from __future__ import annotations

import threading

import bpy
import pytest
from support.training_panel import finish, switched_off

from frog_blender.engine.training.session import events
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask


class Steps:
    """An endless source that counts what it did, and says when it waits."""

    def __init__(self):
        self.done, self.was_paused, self.asked = 0, threading.Event(), threading.Event()

    def __call__(self, control):
        self.was_paused.wait(20.0)  # or the pause might come between the two questions that follow
        while True:
            if control.paused:
                self.asked.set()  # the next thing it does is to wait
            if control():
                break
            self.done += 1
            yield events.Progress(self.done, 1000, 0.1, 0.1, 0.5, 10)
            threading.Event().wait(0.001)
        yield events.Cancelled(self.done, None)


@pytest.fixture
def held(addon):
    """(task, source) of a training that was paused and waits."""
    source = Steps()
    task = TrainingTask(source).begin()
    assert bpy.ops.frog.pause_training() == {"FINISHED"}
    source.was_paused.set()
    assert source.asked.wait(20.0)
    return task, source


def test_a_paused_training_does_nothing_and_goes_on(held):
    task, source = held
    assert task.paused and TrainingTask.is_any_running() and not TrainingTask.is_computing()
    done = source.done
    threading.Event().wait(0.1)
    assert source.done == done
    assert not bpy.ops.frog.pause_training.poll() and bpy.ops.frog.resume_training.poll()
    assert bpy.ops.frog.resume_training() == {"FINISHED"}
    assert not task.paused
    while source.done == done:
        threading.Event().wait(0.005)
    assert not bpy.ops.frog.resume_training.poll() and bpy.ops.frog.pause_training.poll()


def test_cancelled_while_paused(held):
    task, _ = held
    assert bpy.ops.frog.cancel_training() == {"FINISHED"}
    assert finish(task).is_cancelled and not TrainingTask.is_any_running()
    assert not task.paused and not bpy.ops.frog.pause_training.poll()


def test_switched_off_while_paused(held):
    task, _ = held
    with switched_off():
        assert task.join(0.0) and TrainingTask.current() is None
        assert not bpy.app.timers.is_registered(background_task.tick)
