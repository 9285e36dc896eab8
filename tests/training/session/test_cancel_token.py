"""Holding, ending and watching a training from another thread."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import scene_file, until
from support.training_steps import MakeJob, stepping, warnings_of

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events, live_scene, loop, pictures
from frog_blender.engine.training.session.cancel_token import CancelToken
from frog_blender.engine.training.session.checkpoint import checkpoint_settings
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.live_scene import LiveScene, Rest
from frog_blender.engine.training.session.output_paths import checkpoint_path, header_of
from frog_blender.engine.training.session.pictures import preview_shot
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.session import Session

STEPS, PAUSED_AT = 40, 15


@pytest.fixture
def task(make_job: MakeJob) -> TrainingJob:
    return make_job(STEPS)


def at_step(at: int, do: Callable[[], None], done: list[int] | None = None) -> type[Trainer]:
    """Trainers that call ``do`` once step ``at`` is done; ``done`` grows by the steps taken."""

    def after(trainer: Trainer) -> None:
        if done is not None:
            done.append(trainer.step_count)
        if trainer.step_count == at:
            do()

    return stepping(after)


class Worker:
    """A training on a thread of its own."""

    def __init__(self, job: TrainingJob, control: CancelToken, trainer_type: type[Trainer] = Trainer) -> None:
        self.said: list[Any] = []
        self._thread = threading.Thread(target=self._work, args=(job, control, trainer_type), daemon=True)
        self._thread.start()

    def _work(self, job: TrainingJob, control: CancelToken, trainer_type: type[Trainer]) -> None:
        for event in run_training(job, control, trainer_type=trainer_type):
            self.said.append(event)

    def end(self) -> Any:
        self._thread.join(60)
        assert not self._thread.is_alive()
        return self.said[-1]


def test_a_pause_costs_nothing_and_changes_nothing(task: TrainingJob) -> None:
    undisturbed = replace(task, output=task.output.with_name("other.frog"))
    list(run_training(undisturbed))
    control, done = CancelToken(), []
    worker = Worker(task, control, at_step(PAUSED_AT, control.pause, done))
    until(lambda: checkpoint_path(task.output).is_file())  # written before it waits
    threading.Event().wait(0.2)
    assert done[-1] == PAUSED_AT and checkpoint_settings(checkpoint_path(task.output))
    assert [event.step for event in worker.said if isinstance(event, events.Progress)][-1] == PAUSED_AT
    control.resume()
    assert isinstance(worker.end(), events.Finished) and done[-1] == STEPS
    arrays, others = read_scene(task.output).arrays, read_scene(undisturbed.output).arrays
    for name, array in others.items():
        np.testing.assert_array_equal(arrays[name], array)


def test_a_pause_that_comes_while_an_image_is_drawn_is_saved_first(task: TrainingJob) -> None:
    control, paused_at = CancelToken(), []

    class Pausing(Trainer):
        def render_image(self, *arguments: Any) -> Any:
            if self.step_count >= PAUSED_AT and not paused_at:
                paused_at.append(self.step_count)
                control.pause()
            return super().render_image(*arguments)

    worker = Worker(task, control, Pausing)
    until(lambda: checkpoint_path(task.output).is_file())
    threading.Event().wait(0.2)
    assert header_of(checkpoint_path(task.output))["step_count"] == paused_at[0]
    control.resume()
    assert isinstance(worker.end(), events.Finished)


def test_a_pause_is_no_training_time(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that stands still but in the pause, which lasts an hour."""
    control, clock = CancelToken(), [0.0]
    monkeypatch.setattr("frog_blender.engine.training.optimize.trainer.time.perf_counter", lambda: clock[0])
    worker = Worker(task, control, at_step(PAUSED_AT, control.pause))
    until(lambda: checkpoint_path(task.output).is_file())
    clock[0] += 3600.0
    control.resume()
    assert worker.end().seconds == 0.0


def test_cancelling_a_paused_training_keeps_what_it_learned(task: TrainingJob) -> None:
    control = CancelToken()
    worker = Worker(task, control, at_step(PAUSED_AT, control.pause))
    until(lambda: checkpoint_path(task.output).is_file())
    control.cancel()
    end = worker.end()
    assert isinstance(end, events.Cancelled) and end.step == PAUSED_AT
    assert read_scene(task.output).header.steps == PAUSED_AT
    assert list(run_training(replace(task, resume=True)))[-1].steps == STEPS


def test_decoding_can_be_held_too(task: TrainingJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    control = CancelToken()
    control.pause()
    worker = Worker(task, control)
    threading.Event().wait(0.2)
    assert not [event for event in worker.said if isinstance(event, events.Started)]
    control.cancel()
    assert worker.end() == events.Cancelled(0, None)


def previews_of(stream: list[Any]) -> list[Any]:
    return [event for event in stream if isinstance(event, events.Preview)]


def test_previews_come_at_once_and_every_tenth(task: TrainingJob) -> None:
    steps = [event.step for event in previews_of(list(run_training(task)))]
    assert steps[0] == 1 and len(steps) == 10
    often = [
        event.step for event in previews_of(list(run_training(replace(task, preview_seconds=0.0, overwrite=True))))
    ]
    assert often == list(range(1, STEPS))


def test_previews_are_small_and_show_the_camera_that_was_chosen(task: TrainingJob, capture: Capture) -> None:
    control = CancelToken()
    drawn: list[int] = []

    class Watched(Trainer):
        def step(self) -> None:
            super().step()
            if self.step_count == PAUSED_AT:
                control.preview_camera = "cam03"

        def render_image(self, shot_index: int, largest_side: int | None = None) -> np.ndarray:
            if largest_side:
                drawn.append(shot_index)
            return super().render_image(shot_index, largest_side)

    job = replace(task, preview_camera="cam02", preview_size=24)
    said = list(run_training(job, control, trainer_type=Watched))
    assert {event.image.shape for event in previews_of(said)} == {(18, 24, 3)}
    names = [capture.cameras[capture.shots[shot].camera].name for shot in drawn]
    assert names == sorted(names) and set(names) == {"cam02", "cam03"}
    steps = [event.step for event in previews_of(said)]
    assert PAUSED_AT in steps, "another camera is shown at once"


def test_a_preview_of_no_camera_is_said_once(task: TrainingJob) -> None:
    said = list(run_training(replace(task, preview_camera="cam77", preview_seconds=0.0)))
    (warning,) = warnings_of(said)
    assert "cam77" in warning and len(previews_of(said)) == STEPS - 1


def test_what_previews_show_by_default(capture: Capture) -> None:
    shot = preview_shot(capture)
    assert shot is not None and capture.cameras[capture.shots[shot].camera].name == film.HELD_OUT
    chosen = preview_shot(capture, "cam02")
    assert chosen is not None and capture.shots[chosen].frame == film.FRAMES // 2
    assert preview_shot(capture, "none") is None


def test_work_rests_until_it_has_taken_its_share_of_either_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    wall, processor = [0.0], [0.0]
    clocks = SimpleNamespace(monotonic=lambda: wall[0], thread_time=lambda: processor[0])
    monkeypatch.setattr(live_scene, "time", clocks)
    rest = Rest()
    assert rest.is_over, "the first may be done at once"
    with rest.measured():
        wall[0], processor[0] = 1.0, 0.1
    wall[0], processor[0] = 49.9, 25.0
    assert not rest.is_over
    wall[0] = 50.0
    assert rest.is_over
    with rest.measured():
        processor[0] += 1.0  # none of the wall clock's
    assert not rest.is_over, "each is drawn anew"
    wall[0] = 500.0
    assert not rest.is_over, "a fiftieth of the processor's time is not over"
    processor[0] += 49.0
    assert rest.is_over


def test_there_is_room_for_one_and_it_is_the_newest() -> None:
    live, (one, other) = LiveScene(), (ScenePlayer(scene_file(50, seed=3, sh_count=4)) for _ in range(2))
    assert live.take() is None
    live.offer(one)
    live.offer(other)
    assert live.take() is other and live.take() is None


@pytest.fixture
def without_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A snapshot before every step."""
    monkeypatch.setattr(live_scene.Rest, "is_over", True)


def test_a_training_is_seen_while_it_learns(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, without_rest: None
) -> None:
    taken: list[ScenePlayer] = []
    means: list[np.ndarray] = []
    arrays: list[tuple[Session, ScenePlayer]] = []
    made = pictures.snapshot

    class Looking(LiveScene):
        """Keeps each snapshot, and what it was before the next step."""

        def offer(self, scene: ScenePlayer) -> None:
            taken.append(scene)
            means.append(scene.at(0.5).means.copy())

    def watched(session: Session) -> ScenePlayer:
        player = made(session)
        arrays.append((session, player))
        return player

    monkeypatch.setattr(loop, "snapshot", watched)
    for event in run_training(replace(task, live=Looking())):
        assert not isinstance(event, events.WarningEvent), event
    assert len(taken) >= 2
    for player, was in zip(taken, means, strict=True):
        assert player.count == len(was)
        np.testing.assert_array_equal(player.at(0.5).means, was, "the training that goes on does not change it")
    assert taken[0].header.frame_count == taken[-1].header.frame_count > 1
    session, player = arrays[-1]
    for name, value in session.trainer.model.state_dict().items():
        own = player._arrays.get(name.removeprefix("canonical.").replace("deformation.", "network."))
        assert own is None or not np.shares_memory(own, value.numpy()), name


def test_who_looks_late_sees_the_newest(task: TrainingJob, without_rest: None) -> None:
    live = LiveScene()
    for event in run_training(replace(task, live=live)):
        if isinstance(event, events.Started):
            live.offer(old := ScenePlayer(scene_file(50, seed=3, sh_count=4)))
    newest = live.take()
    assert newest is not None and newest is not old, "what waited since the first step was renewed"


def test_nobody_looks_and_nothing_is_made(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, without_rest: None
) -> None:
    made: list[Session] = []
    monkeypatch.setattr(loop, "snapshot", made.append)
    list(run_training(replace(task, live=LiveScene(is_wanted=False))))
    assert not made


def test_a_snapshot_that_fails_is_told_once_and_the_training_goes_on(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, without_rest: None
) -> None:
    def fail(_session: Session) -> ScenePlayer:
        raise MemoryError("no room")

    monkeypatch.setattr(loop, "snapshot", fail)
    said = list(run_training(replace(task, live=LiveScene())))
    assert sum("cannot be shown while it runs" in warning for warning in warnings_of(said)) == 1
    assert isinstance(said[-1], events.Finished)
