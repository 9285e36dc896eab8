"""Snapshots of a running training: what was learned so far, copied once, when wanted, and at a share of its time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.training.session import events, pictures
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.live_scene import LiveScene, Rest
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.session import Session


class Clock:
    """Stands at what it is told."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def test_work_rests_until_it_has_taken_its_share_of_either_clock() -> None:
    wall, processor = Clock(), Clock()
    rest = Rest(share=0.1, shortest=2.0, clocks=(wall, processor))
    assert rest.is_over, "the first may be done at once"
    with rest.measured():
        wall.seconds, processor.seconds = 1.0, 0.1
    wall.seconds, processor.seconds = 9.9, 5.0
    assert not rest.is_over
    wall.seconds = 10.0
    assert rest.is_over
    with rest.measured():
        processor.seconds += 1.0  # none of the wall clock's
    wall.seconds = 100.0
    assert not rest.is_over, "a tenth of the processor's time is not over"
    processor.seconds += 9.0
    assert rest.is_over


def test_there_is_room_for_one_and_it_is_the_newest() -> None:
    live, (one, other) = LiveScene(), (ScenePlayer(scene_file(50, seed=3, sh_count=4)) for _ in range(2))
    assert live.is_due and live.take() is None
    live.offer(one)
    assert not live.is_due, "the last one was not taken"
    live.offer(other)
    assert live.take() is other and live.take() is None and live.is_due
    live.is_wanted = False
    assert not live.is_due


def job(filmed: Path, tmp_path: Path, recipe: Recipe, live: LiveScene) -> TrainingJob:
    given = {"recipe": recipe, "steps": 12, "seeds": film.seeds(), "device": "cpu"}
    return TrainingJob(filmed, tmp_path / "x.frog", live=live, **given)


@pytest.fixture
def without_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A snapshot before every step."""
    monkeypatch.setattr(pictures, "Rest", lambda: Rest(shortest=0.0, share=1.0, clocks=(lambda: 0.0,)))


def test_a_training_is_seen_while_it_learns(
    filmed: Path, tmp_path: Path, lively: Callable[..., Recipe], monkeypatch: pytest.MonkeyPatch, without_rest: None
) -> None:
    taken: list[ScenePlayer] = []
    means: list[np.ndarray] = []
    arrays: list[tuple[Session, ScenePlayer]] = []
    made = pictures.snapshot

    class Looking(LiveScene):
        """Whoever shows it takes each snapshot before the next step."""

        @property
        def is_due(self) -> bool:
            if (newest := self.take()) is not None:
                taken.append(newest)
                means.append(newest.at(0.5).means.copy())
            return True

    def watched(session: Session) -> ScenePlayer:
        player = made(session)
        arrays.append((session, player))
        return player

    monkeypatch.setattr(pictures, "snapshot", watched)
    for event in run_training(job(filmed, tmp_path, lively(12), Looking())):
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


def test_nobody_looks_and_nothing_is_made(
    filmed: Path, tmp_path: Path, lively: Callable[..., Recipe], monkeypatch: pytest.MonkeyPatch, without_rest: None
) -> None:
    made: list[Session] = []
    monkeypatch.setattr(pictures, "snapshot", made.append)
    list(run_training(job(filmed, tmp_path, lively(12), LiveScene(is_wanted=False))))
    assert not made


def test_a_snapshot_that_fails_is_told_once_and_the_training_goes_on(
    filmed: Path, tmp_path: Path, lively: Callable[..., Recipe], monkeypatch: pytest.MonkeyPatch, without_rest: None
) -> None:
    def fail(_session: Session) -> ScenePlayer:
        raise MemoryError("no room")

    monkeypatch.setattr(pictures, "snapshot", fail)
    said = list(run_training(job(filmed, tmp_path, lively(12), LiveScene())))
    warnings = [event.message for event in said if isinstance(event, events.WarningEvent)]
    assert sum("cannot be shown while it runs" in each for each in warnings) == 1
    assert isinstance(said[-1], events.Finished)
