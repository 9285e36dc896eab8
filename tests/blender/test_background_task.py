"""Work beside Blender's main thread, of every kind: pump() is bounded and never waits, every end is a plain state."""

import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from support.builders import refused
from support.training_panel import finish, switched_off

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.child_process import Stopped
from frog_blender.engine.training.session import events
from frog_blender.operators import quit as quit_operator
from frog_blender.tasks import background_task
from frog_blender.tasks.background_task import PUMP_MESSAGES, TIMER_SECONDS, BackgroundTask, Progress
from frog_blender.tasks.calibration import CalibrationTask
from frog_blender.tasks.foreign_import import ForeignImport
from frog_blender.tasks.installation import Installation
from frog_blender.tasks.scene_capture import SceneCaptureTask
from frog_blender.tasks.training import TrainingTask


def scene_capture(folder):
    task = SceneCaptureTask(SimpleNamespace(images=[], missing=[], folder=folder, cameras=[]))
    task.start = lambda: BackgroundTask.start(task)  # without a copy of the open file
    return task


KINDS = {
    "training": lambda folder: TrainingTask(lambda control: iter(())),
    "calibration": CalibrationTask,
    "scene": scene_capture,
    "installation": lambda folder: Installation(folder / "torch"),
    "import": lambda folder: ForeignImport(folder / "x.ply", None),
}


@pytest.fixture(params=KINDS)
def create(request, addon, tmp_path):
    """Makes a task of each kind that does the work of a function, which is given the task."""

    def task(work):
        made = KINDS[request.param](tmp_path)
        made.work = lambda: work(made)
        return made

    return task


class Work(BackgroundTask):
    """Something or other."""

    what, busy = "work", "There is work already."

    def __init__(self, function, on_finished=None):
        super().__init__()
        self.function, self.on_finished = function, on_finished

    def work(self):
        return self.function(self)


def until_stopped(task):
    assert task.stopped.wait(20.0)


def test_progress_and_the_result_arrive(addon):
    gate, made = threading.Event(), []

    def work(task):
        task.tell("films", 3, 4)
        gate.wait(20.0)
        return "x.frog"

    task = Work(work, made.append).start()
    while not task.pump():
        pass
    assert task.is_running and task.progress == Progress("films", 3, 4)
    assert task.pump() == 0, "it does not wait"
    gate.set()
    assert finish(task).result == "x.frog" and made == ["x.frog"] and not task.error and not task.is_cancelled


def test_pump_takes_a_bounded_number_and_leaves_the_rest(addon):
    task = Work(lambda task: [task.tell("steps", step, 5000) for step in range(1, 5001)]).start()
    assert task.join(20.0)
    first = task.pump()
    assert 0 < first <= PUMP_MESSAGES and task.progress.done == first and task.is_running
    assert task.pump(most=7) <= 7
    assert finish(task).progress.done == 5000


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (FrogError("It does not fit."), "It does not fit."),
        (KeyError("x"), "x.frog: written, but it could not be opened (KeyError('x'))."),
    ],
)
def test_a_result_that_cannot_be_opened_says_so(addon, capfd, error, sentence):
    def fail(result):
        raise error

    task = finish(Work(lambda task: "x.frog", fail).start())
    assert task.error == sentence
    assert task.result == "x.frog" and ("Traceback" in capfd.readouterr().err) == isinstance(error, KeyError)


def test_what_was_made_in_time_counts_though_it_was_cancelled(addon):
    task = Work(lambda task: until_stopped(task) or "x.frog").start()
    task.cancel()
    assert task.is_stopping
    assert finish(task).result == "x.frog" and not task.is_cancelled


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (FrogError("/x: found nothing."), "/x: found nothing."),
        (ZeroDivisionError("a\nb"), " stopped on an unexpected ZeroDivisionError (a b)."),
        (MemoryError(), " ran out of memory."),
    ],
)
def test_an_error_is_one_sentence(create, capfd, error, sentence):
    def work(task):
        raise error

    task = finish(create(work).start())
    assert task.error.endswith(sentence) and task.result is None and not task.is_cancelled
    assert ("Traceback" in capfd.readouterr().err) != isinstance(error, FrogError)


def test_a_worker_that_dies_without_a_word_is_noticed(create):
    """As without memory for a last message."""
    task = create(lambda task: None)
    task.put = lambda message: None
    assert "stopped without an error message" in finish(task.start()).error


def test_cancelling_is_no_error(create, capfd):
    def work(task):
        until_stopped(task)
        raise FrogError("Ended.") if isinstance(task, ForeignImport) else Stopped

    task = create(work)
    task.on_finished = lambda result: pytest.fail("nothing was made")
    task.start().cancel()
    finish(task)
    assert (task.is_cancelled and not task.error) or isinstance(task, TrainingTask)  # whose events say it
    assert "Traceback" not in capfd.readouterr().err


def test_without_a_thread_there_is_one_sentence(create, monkeypatch):
    def start(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    task = create(lambda task: None)
    refused("could not be started", task.begin)
    assert not task.is_any_running()


def test_one_at_a_time_and_none_outlives_the_add_on(create):
    task = create(until_stopped).begin()
    assert task.current() is task and task.is_any_running()
    assert bpy.app.timers.is_registered(background_task.tick)
    refused(r"already|is running", create(until_stopped).begin)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert bpy.app.timers.is_registered(background_task.tick) and task.current() is task, "another file does not end it"
    assert not task.is_stopping
    with switched_off():
        assert task.join(0.0) and task.current() is None and not bpy.app.timers.is_registered(background_task.tick)


def test_the_timer_ends_with_the_last_of_several(addon):
    gate, made = threading.Event(), []
    first = Work(lambda task: gate.wait(20.0), made.append).begin()
    other = CalibrationTask(Path())
    other.work = lambda: None
    other.begin()
    assert other.join(20.0)
    other.pump_all()
    assert background_task.tick() == TIMER_SECONDS and not other.is_running
    gate.set()
    assert first.join(20.0)
    while background_task.tick() is not None:
        pass
    assert made == [True]


def test_quitting_says_what_runs_and_what_is_kept(addon):
    assert not background_task.at_quitting()
    training = TrainingTask(lambda control: iter(()))
    training.apply(events.Started("frog", 3000, 4, 6, 300, step=1200))
    training.show()
    CalibrationTask(Path("films")).show()
    assert background_task.at_quitting() == [
        "The training is not done yet. What it has learned by then is saved, and Resume goes on from there.",
        "The calibration is not done yet. Stages that are done are kept: the next calibration continues there.",
    ]
    assert training.standing.stage == "Step 1,200 of 3,000", "a resumed training begins at its step"


def test_quitting_goes_on_where_all_has_ended_before_the_answer(addon, monkeypatch):
    calls = []
    quit_blender = SimpleNamespace(quit_blender=lambda *how: calls.append(how) or {"CANCELLED"})
    assert bpy.ops.frog.quit.poll(), "Blender asks again when the button of the question is pressed"
    monkeypatch.setattr(quit_operator, "bpy", SimpleNamespace(ops=SimpleNamespace(wm=quit_blender)))
    quit_operator.FROG_OT_quit.act(None, None)
    assert quit_operator.FROG_OT_quit.invoke(None, None, None) == {"CANCELLED"}, "nothing to ask: Blender's own"
    assert calls == [("INVOKE_DEFAULT",)] * 2


def test_a_bar_never_goes_back_and_moves_while_nothing_is_told(addon, monkeypatch):
    task, clock = TrainingTask(lambda control: iter(())), [0.0]
    monkeypatch.setattr(background_task, "time", SimpleNamespace(monotonic=lambda: clock[0]))

    def shown(*event):
        for each in event:
            task.apply(each)
        return task.standing.fraction

    fractions = [shown(events.Stage("Decoding frames", 1, 2, 0.2, 80.0))]
    clock[0] = 30.0
    fractions += [
        shown(),
        shown(events.Started("frog", 100, 4, 6, 300)),
        shown(events.Progress(1, 100, 0, 80, 0, 1, 0, 0.3)),
    ]
    assert fractions == sorted(fractions) and fractions[1] > 0.25
    task.control.pause()
    before = shown()
    clock[0] = 5000.0
    assert shown() == before, "paused"
