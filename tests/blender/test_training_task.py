"""The training task: events arrive, pump() is bounded and never waits, and every end is a plain state."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from safetensors.numpy import save_file

from frog_blender import addon_state, unsaved_changes
from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.session import events
from frog_blender.operators import training_result
from frog_blender.tasks import training
from frog_blender.tasks.background_task import PUMP_MESSAGES
from frog_blender.timeline import playback
from frog_blender.ui import capture_summary


def finish(task):
    """Pump until the training ends, as a headless run does."""
    assert task.join(20.0)
    while task.pump():
        pass
    return task.state


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
    state = finish(training.TrainingTask(lambda cancelled: iter(said), finished.append).start())
    assert (state.step, state.steps, state.gaussians, state.psnr) == (50, 50, 500, 28.0)
    assert state.warnings == ["The room is dark."] and not state.running and not state.error
    assert state.result == tmp_path / "a.frog" and finished == [state.result]


def test_pump_takes_a_bounded_number_and_leaves_the_rest(addon):
    task = training.TrainingTask(lambda cancelled: iter(steps(5000))).start()
    assert task.join(20.0)
    first = task.pump()
    assert 0 < first <= PUMP_MESSAGES
    assert task.state.step == first and task.state.running
    assert task.pump(most=7) <= 7
    assert finish(task).step == 5000


def test_pump_does_not_wait_for_a_worker_that_is_silent(addon):
    gate = threading.Event()

    def source(cancelled):
        gate.wait(20.0)
        yield from steps(3)

    task = training.TrainingTask(source).start()
    assert task.pump() == 0 and task.state.running  # a pump that waited would not come back before the gate opens
    gate.set()
    assert finish(task).step == 3


def test_cancel_reaches_the_worker(addon):
    def source(cancelled):
        yield from steps(2)
        while not cancelled():
            pass
        yield events.Cancelled(2, "half.frog")

    task = training.TrainingTask(source, lambda path: pytest.fail("a cancelled training is not imported")).start()
    task.cancel()
    state = finish(task)
    assert state.cancelled and state.result.name == "half.frog" and not state.running


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (FrogError("/x: found nothing, expected videos."), "/x: found nothing, expected videos."),
        (KeyError("k"), "KeyError"),
    ],
)
def test_errors_are_one_sentence(addon, error, sentence, capfd):
    def source(cancelled):
        yield from steps(1)
        raise error

    state = finish(training.TrainingTask(source).start())
    assert sentence in state.error and "\n" not in state.error and not state.running
    assert ("Traceback" in capfd.readouterr().err) == isinstance(error, KeyError)


def test_an_import_that_fails_at_the_end_is_an_error_in_the_state(addon):
    def refuse(path):
        raise FrogError(f"{path}: found a directory, expected a file.")

    said = [events.Finished("x.frog", 1, 1.0, 20.0, 5)]
    state = finish(training.TrainingTask(lambda cancelled: iter(said), refuse).start())
    assert state.error == "x.frog: found a directory, expected a file." and not state.running


def test_nothing_is_imported_while_a_render_looks_at_the_scene(addon, request):
    renders, imported = ["RENDER"], []
    said = [events.Finished("x.frog", 1, 1.0, 20.0, 5)]
    task = training.TrainingTask(lambda cancelled: iter(said), imported.append, is_scene_in_use=lambda: bool(renders))
    assert not finish(task.start()).running
    task.hand_over()
    assert task.waiting is not None and not imported
    request.addfinalizer(lambda: training.set_current(None))
    training.set_current(task)
    with pytest.raises(FrogError, match="Finish the current render"):  # another training would take its place
        training.begin(lambda cancelled: iter([]))
    renders.clear()
    for _ in range(2):
        task.hand_over()
    assert task.waiting is None and imported == [Path("x.frog")]


def test_what_an_import_needs_is_made_a_tick_before_it(addon):
    """Neither keeps the user waiting as long as both together."""
    done = []
    source = lambda cancelled: iter([events.Finished("x.frog", 1, 1.0, 20.0, 5)])  # noqa: E731
    task = training.begin(source, lambda path: done.append(path), prepare=lambda: done.append("prepared"))
    try:
        assert task.join(20.0)
        while not done:
            assert training.tick() is not None
        assert done == ["prepared"] and task.waiting is not None
        assert training.tick() is None and done == ["prepared", Path("x.frog")]
    finally:
        training.set_current(None)


def test_a_scene_that_was_renamed_meanwhile_gets_the_import(empty, static_rig):
    show = training_result.ResultImporter(empty)
    empty.name = "Another"
    bpy.data.scenes.new("Scene")
    show(static_rig)
    assert [playback.file_of(obj) for obj in playback.captures(empty.objects)] == [static_rig]


@pytest.fixture
def endless(addon):
    """A training that goes on until it is told to end, and then leaves a scene."""

    def source(cancelled):
        while not cancelled():
            yield events.Stage("decoding", 0, 1)
            threading.Event().wait(0.005)
        yield events.Cancelled(3, "half.frog")

    task = training.begin(source)
    yield task
    task.cancel()
    finish(task)
    training.set_current(None)


def test_only_one_training_at_a_time(endless):
    assert training.is_running() and bpy.app.timers.is_registered(training.tick)
    with pytest.raises(FrogError, match="already running"):
        training.begin(lambda cancelled: iter([]))


def test_opening_another_file_neither_ends_a_training_nor_waits_for_it(endless, tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    assert training.current() is endless and training.is_running() and not endless.control.ended
    assert bpy.app.timers.is_registered(training.tick)
    endless.cancel()
    state = finish(endless)
    assert state.cancelled and state.result == Path("half.frog")


@pytest.mark.parametrize("learned", [False, True], ids=["decoding", "training"])
def test_at_the_end_there_is_so_much_patience(addon, capfd, learned):
    """What is being saved is waited for; what hangs is not."""
    gate, taken = threading.Event(), threading.Event()
    addon_state.put(training.BackgroundTraining(patience=0.01, quit_seconds=0.05))

    def source(cancelled):
        yield steps(1)[0] if learned else events.Stage("decoding", 0, 1)
        taken.set()
        gate.wait(20.0)

    task = training.begin(source)
    assert taken.wait(20.0) and task.pump() == 1
    addon.unregister()
    try:
        assert not task.join(0.0) and training.current() is None
        said = capfd.readouterr().err
        assert ("Saving what the training has learned" in said) == learned
        assert ("The last checkpoint is kept" in said) == learned
        assert "That took longer." in said
    finally:
        addon.register()
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


def test_the_file_counts_as_unsaved_while_a_training_runs(endless, file):
    for _ in range(3):
        assert training.tick() is not None
    assert len(file.pushed) == 1
    file.is_dirty = False  # the user saves meanwhile
    training.tick()
    assert len(file.pushed) == 2
    endless.cancel()
    finish(endless)
    file.is_dirty = False
    assert training.tick() is None and len(file.pushed) == 2


def test_a_file_that_is_saved_after_an_undo_can_still_redo(endless, file):
    file.can_redo = True
    training.tick()
    assert not file.pushed
    file.can_redo = False  # something new was done, and saved
    training.tick()
    assert len(file.pushed) == 1


def test_a_file_becomes_unsaved(empty):
    if bpy.data.is_dirty:
        pytest.skip("without a window this Blender counts every file as unsaved")
    unsaved_changes.count_as_unsaved()
    assert bpy.data.is_dirty


def test_an_import_waits_for_the_end_of_an_operation(addon):
    busy, imported = [True], []
    task = training.TrainingTask(
        lambda control: iter([events.Finished("x.frog", 1, 1.0, 20.0, 5)]),
        imported.append,
        is_scene_in_use=lambda: bool(busy),
    )
    finish(task.start())
    assert not imported and task.waiting is not None
    busy.clear()
    task.hand_over()
    assert imported == [Path("x.frog")]


def test_an_import_that_fails_in_an_unforeseen_way_is_a_sentence_too(addon, capfd):
    def fail(path):
        raise KeyError("no such thing")

    task = training.begin(lambda cancelled: iter([events.Finished("x.frog", 1, 1.0, 20.0, 5)]), fail)
    assert task.join(20.0)
    while training.tick() is not None:
        pass
    assert "x.frog: the scene was trained, but could not be imported (KeyError" in task.state.error
    assert not task.state.running and task.state.result == Path("x.frog") and "Traceback" in capfd.readouterr().err


def test_an_event_that_cannot_be_shown_ends_nothing(addon):
    said = [events.Stage("decoding", 1, None), events.Finished("x.frog", 7, 1.0, 20.0, 5, {"what": "no summary"})]
    imported = []
    state = finish(training.TrainingTask(lambda cancelled: iter(said), imported.append).start())
    assert len(state.warnings) == 2 and "cannot be shown" in state.warnings[0]
    assert not state.running and not state.error and imported == [Path("x.frog")] and state.step == 7


def test_an_image_that_cannot_be_shown_ends_nothing(endless, capfd):
    training.watch(lambda state: 1 / 0)
    while not endless.state.stage_fraction and not capfd.readouterr().err:
        assert training.tick() is not None, "the timer goes on"
    assert endless.state.running


def test_a_worker_that_dies_without_a_word_is_noticed(addon):
    class Dying(training.TrainingTask):
        def work(self):
            """As without memory for a last message."""

    state = finish(Dying(lambda cancelled: iter([])).start())
    assert (
        state.error == "The training stopped without an error message. It may have run out of memory."
        and not state.running
    )


def test_without_a_thread_there_is_one_sentence(addon, monkeypatch):
    def start(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    with pytest.raises(FrogError, match="could not be started"):
        training.begin(lambda cancelled: iter([]))
    assert not training.is_running()


def test_train_operator_says_what_is_missing(empty, tmp_path):
    with pytest.raises(RuntimeError, match="No capture is selected"):
        bpy.ops.frog.train()
    empty.frog.capture_folder = str(tmp_path / "nowhere")
    with pytest.raises(RuntimeError, match="nowhere: there is no such folder"):
        bpy.ops.frog.train()
    assert not training.is_running()


def test_naming_a_folder_says_what_it_is(empty, tmp_path):
    from frog_blender.ui import capture_summary

    (tmp_path / "notes.txt").write_text("nothing to train from")
    empty.frog.capture_folder = str(tmp_path)
    summary = capture_summary.known(bpy.path.abspath(empty.frog.capture_folder))
    assert summary.error and str(tmp_path) in summary.error and not summary.lines
    assert empty.frog.output_path == f"{tmp_path}.frog"


def test_what_the_panel_asks_for(empty, tmp_path):
    from frog_blender.tasks.training_request import can_resume, request_of

    settings = empty.frog
    settings.capture_folder, settings.output_path = str(tmp_path), str(tmp_path / "scene")
    request = request_of(settings)
    assert (request.output, request.capacity, request.job["resume"]) == (tmp_path / "scene.frog", "auto", False)
    assert not can_resume(settings)
    (tmp_path / "scene.frog.checkpoint").write_bytes(b"x")
    assert not can_resume(settings), "what cannot be read is not resumed"
    state = json.dumps({"settings": {"capture": str(tmp_path.resolve())}, "progress": 0.5, "step_count": 7})
    save_file({"x": np.zeros(1)}, tmp_path / "scene.frog.checkpoint", metadata={"frog-checkpoint": state})
    assert can_resume(settings) and request_of(settings, resume=True).job["resume"]
    settings.capacity, settings.device, settings.preview_camera = "fixed", "cpu", "cam02"
    request = request_of(settings)
    assert (request.capacity, request.job["device"], request.job["preview_camera"]) == ("fixed", "cpu", "cam02")


def test_a_request_names_what_the_engine_knows(empty, tmp_path):
    pytest.importorskip("torch")
    from dataclasses import fields

    from frog_blender.engine.training.optimize.device import DEVICES
    from frog_blender.engine.training.recipe import RECIPES
    from frog_blender.engine.training.session.job import TrainingJob
    from frog_blender.tasks.training_request import request_of
    from frog_blender.ui import training_settings

    empty.frog.capture_folder = str(tmp_path)
    assert set(request_of(empty.frog).job) <= {field.name for field in fields(TrainingJob)}
    assert [name for name, *_ in training_settings.DEVICES] == [*DEVICES, "remote"]
    assert {name for name, *_ in training_settings.RECIPES} <= set(RECIPES)


def test_resuming_what_is_no_checkpoint_is_one_sentence(empty, tmp_path):
    pytest.importorskip("torch")
    settings = empty.frog
    settings.capture_folder, settings.output_path = str(tmp_path), str(tmp_path / "scene.frog")
    (tmp_path / "scene.frog.checkpoint").write_bytes(b"x")
    addon_state.reset(capture_summary.Inspected)  # as in a file that was just opened
    assert bpy.ops.frog.train(resume=True) == {"FINISHED"}
    task = training.current()
    assert task.join(60)
    while task.pump():
        pass
    assert "scene.frog.checkpoint" in task.state.error and "\n" not in task.state.error
