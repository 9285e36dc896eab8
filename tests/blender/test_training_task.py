"""The training task: events arrive, it is held and goes on, and every end is a plain state."""

import shutil
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from support.training_panel import endless, finish, switched_off

from frog_blender import unsaved_changes
from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.session import events
from frog_blender.operators.modal_operator import ModalOperator
from frog_blender.operators.train import ResultImporter
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.timeline import open_scenes, playback


def steps(count):
    return [events.Progress(i, count, 0.1 * i, 0.1 * (count - i), 1.0 / i, 10 * i) for i in range(1, count + 1)]


def test_events_become_state(addon, tmp_path):
    finished = []
    said = [
        events.Stage("decoding", 1, 4),
        events.Started("frog", 50, 3, 10, 100),
        *steps(50),
        events.Evaluated(50, 27.5, "held-out"),
        events.Preview(50, np.zeros((2, 2, 3), np.uint8)),
        events.WarningEvent("The room is dark."),
        events.Saved(str(tmp_path / "a.frog")),
        events.Finished(str(tmp_path / "a.frog"), 50, 5.0, 28.0, 500),
    ]
    task = finish(TrainingTask(lambda cancelled: iter(said), finished.append).start())
    state = task.state
    assert (state.step, state.steps, state.gaussians, state.psnr) == (50, 50, 500, 28.0)
    assert state.warnings == ["The room is dark."] and not task.error and not task.is_cancelled
    assert task.result == tmp_path / "a.frog" and finished == [task.result]


def test_an_error_of_one_that_was_cancelled_is_told(addon):
    """What it has learned may be lost."""

    def source(cancelled):
        while not cancelled():
            pass
        yield from ()
        raise FrogError("The disk is full.")

    task = TrainingTask(source).start()
    task.cancel()
    assert finish(task).error == "The disk is full." and not task.is_cancelled


def test_nothing_is_imported_while_a_render_looks_at_the_scene(addon, monkeypatch):
    renders, imported = ["RENDER"], []
    monkeypatch.setattr(unsaved_changes, "is_scene_in_use", lambda: bool(renders))
    said = [events.Finished("x.frog", 1, 1.0, 20.0, 5)]
    task = TrainingTask(lambda cancelled: iter(said), imported.append)
    finish(task.start())
    task.hand_over_when_possible()
    assert task.waiting is not None and not imported
    task.show()
    with pytest.raises(FrogError, match="Finish the current render"):  # another training would take its place
        TrainingTask(lambda cancelled: iter([])).begin()
    renders.clear()
    for _ in range(2):
        task.hand_over_when_possible()
    assert task.waiting is None and imported == [Path("x.frog")]


def test_scenes_of_trainings_before_are_let_go(empty, static_rig, tmp_path):
    """Each is read before it is imported, so that opening it finds nothing new."""
    for name in "abc":
        path = Path(shutil.copy(static_rig, tmp_path / f"{name}.frog"))
        said = [events.Finished(str(path), 1, 1.0, 20.0, 5)]
        for obj in list(playback.captures(empty.objects)):
            bpy.data.objects.remove(obj)
        finish(TrainingTask(lambda cancelled, said=said: iter(said), ResultImporter(empty)).start())
        assert open_scenes.paths() == {path}


def test_a_scene_that_was_renamed_meanwhile_gets_the_import(empty, static_rig):
    show = ResultImporter(empty)
    empty.name = "Another"
    bpy.data.scenes.new("Scene")
    show(static_rig)
    assert [playback.file_of(obj) for obj in playback.captures(empty.objects)] == [static_rig]


@pytest.fixture
def running(addon):
    """A training that goes on until it is told to end, and then leaves a scene."""
    return TrainingTask(endless, lambda path: pytest.fail("a cancelled training is not imported")).begin()


@pytest.mark.parametrize("learned", [False, True], ids=["decoding", "training"])
def test_at_the_end_there_is_so_much_patience(addon, capfd, monkeypatch, learned):
    """What is being saved is waited for; what hangs is not."""
    gate, taken = threading.Event(), threading.Event()
    monkeypatch.setattr(TrainingTask, "patience", 0.01)
    monkeypatch.setattr(TrainingTask, "quit_seconds", 0.05)

    def source(cancelled):
        yield steps(1)[0] if learned else events.Stage("decoding", 0, 1)
        taken.set()
        gate.wait(20.0)

    task = TrainingTask(source).begin()
    assert taken.wait(20.0) and task.pump() == 1
    with switched_off():
        assert not task.join(0.0) and TrainingTask.current() is None
    said = capfd.readouterr().err
    assert ("Saving what the training has learned" in said) == learned
    assert ("The last checkpoint is kept" in said) == learned
    assert "That took longer." in said
    gate.set()
    assert task.join(20.0)


@pytest.fixture
def file(monkeypatch):
    """Stands in for the open one: whether it is unsaved, can redo, and what was pushed on its undo stack."""
    file = SimpleNamespace(is_dirty=False, can_redo=False, pushed=[])

    def push(message):
        file.pushed.append(message)
        file.is_dirty = True

    ed = SimpleNamespace(undo_push=push, redo=SimpleNamespace(poll=lambda: file.can_redo))
    stand_in = SimpleNamespace(data=file, context=bpy.context, ops=SimpleNamespace(ed=ed))
    monkeypatch.setattr(unsaved_changes, "bpy", stand_in)
    return file


def test_the_file_counts_as_unsaved_while_a_training_runs(running, file):
    for _ in range(3):
        assert background_task.tick() is not None
    assert len(file.pushed) == 1
    file.is_dirty = False  # the user saves meanwhile
    background_task.tick()
    assert len(file.pushed) == 2 and not running.control.ended
    running.cancel()
    assert finish(running).is_cancelled and running.result == Path("half.frog")
    file.is_dirty = False
    assert background_task.tick() is None and len(file.pushed) == 2


def test_a_file_that_is_saved_after_an_undo_can_still_redo(running, file):
    file.can_redo = True
    background_task.tick()
    assert not file.pushed
    file.can_redo = False  # something new was done, and saved
    background_task.tick()
    assert len(file.pushed) == 1


def test_what_waits_is_bounded_and_its_last_words_are_kept(addon):
    """While Blender is busy, whatever another computer sends."""

    def flood(cancelled):
        for index in range(5000):
            yield events.Preview(index, np.full((2, 2, 3), index % 256, np.uint8))
            yield from steps(1)
        yield events.WarningEvent("It is full.")
        yield events.Cancelled(5, None)

    task = TrainingTask(flood).start()
    assert task.join(60.0) and task._messages.qsize() < 1010
    finish(task)
    assert task.state.preview[0, 0, 0] == 4999 % 256 and task.state.warnings == ["It is full."] and task.is_cancelled


def test_a_context_without_a_window_as_timers_may_have_it(addon):
    """Blender crashes where a status bar's text is set in one."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    operator, told = ModalOperator(), (step for step in (1, 2))
    operator._steps, operator.timer = told, bpy.context.window_manager.event_timer_add(10.0)
    operator._show_progress(bpy.context)
    assert operator._workspaces
    with bpy.context.temp_override(window=None):
        assert bpy.context.window is None and bpy.context.window_manager.windows
        TrainingTask(lambda cancelled: iter(steps(1))).redraw()
        operator._show_progress(bpy.context)
        operator.cancel(bpy.context)
    assert not operator._workspaces


def test_an_event_that_cannot_be_shown_ends_nothing(addon):
    said = [events.Stage("decoding", 1, None), events.Finished("x.frog", 7, 1.0, 20.0, 5, {"what": "no summary"})]
    imported = []
    task = finish(TrainingTask(lambda cancelled: iter(said), imported.append).start())
    assert len(task.state.warnings) == 2 and "cannot be shown" in task.state.warnings[0]
    assert not task.error and imported == [Path("x.frog")] and task.state.step == 7


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
