"""What a training does besides learning, and may leave undone: whatever fails there, what was learned plays."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.compression import schedule
from frog_blender.engine.training.compression.context import CompressionContext, CompressionStep, Proposal
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events, export, loop
from frog_blender.engine.training.session.export import BuiltScene, Metrics
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.session import Session

STEPS = 40
MORE_THAN_ONCE = ("evaluate", "freeze_motion", "mean_dynamic_state", "to_json")
ERRORS = [
    RuntimeError("torch does not like this"),
    np.linalg.LinAlgError("singular matrix"),
    ValueError("cannot convert float NaN to integer\nand more"),
    MemoryError(),
]
AT_THE_END = [
    *((schedule, name) for name in ("freeze_motion", "prune_hidden_units", "prune_heads")),
    (CompressionContext, "mean_dynamic_state"),
    *((export, name) for name in ("freeze_attributes", "reorder_for_playback", "playback_steps")),
    (CompressionStep, "to_json"),
    *((loop, name) for name in ("fit_budget", "draw_report_image")),
    (Trainer, "evaluate"),
]
ON_THE_WAY = [
    (schedule, name) for name in ("freeze_static_regions", "unfreeze_high_error", "prune", "reduce_sh_degree")
]


def name_of(value: Any) -> str | None:
    return value[1] if isinstance(value, tuple) else None


@pytest.fixture
def task(filmed: Path, tmp_path: Path, lively: Callable, seeds_at_no_cost: None) -> TrainingJob:
    settings = lively(STEPS, capacity="auto")
    return TrainingJob(filmed, tmp_path / "x.frog", recipe=settings, seed=2, device="cpu")


def broken(monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception) -> None:
    """Lets ``what`` fail; what is done in the middle of a training as well, only at its end."""
    owner, name = what
    real = getattr(owner, name)

    def fails(*arguments: Any, **options: Any) -> Any:
        first = arguments[0]
        training = first.training if isinstance(first, CompressionContext) else first
        ended = training.progress == 1 if isinstance(training, Trainer) else getattr(first, "progress", 1.0) == 1
        if name in MORE_THAN_ONCE and not ended:
            return real(*arguments, **options)
        raise error

    monkeypatch.setattr(owner, name, fails)


def plays(task: TrainingJob) -> ScenePlayer:
    """The scene that lies where the job wants it, played at some moments."""
    scene = ScenePlayer.load(task.output)
    for moment in (0.0, 0.4, 1.0):
        assert all(np.isfinite(values).all() for values in vars(scene.at(moment)).values())
    return scene


def check(task: TrainingJob, monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception) -> None:
    broken(monkeypatch, what, error)
    stream = list(run_training(task))
    said = [event.message for event in stream if isinstance(event, events.WarningEvent)]
    assert isinstance(stream[-1], events.Finished) and plays(task).header.steps == STEPS
    assert all(message.endswith(".") and "\n" not in message for message in said)
    assert len(said) == (2 if what[1] == "unfreeze_high_error" else 1)  # at two milestones


@pytest.mark.parametrize(("number", "what"), list(enumerate([*AT_THE_END, *ON_THE_WAY])), ids=name_of)
def test_a_pass_that_fails_costs_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, number: int, what: tuple[Any, str]
) -> None:
    errors = ERRORS if what in AT_THE_END else ERRORS[:3]  # memory that ends in the middle costs Gaussians
    check(task, monkeypatch, what, errors[number % len(errors)])


@pytest.mark.slow
@pytest.mark.parametrize(("what", "error"), list(itertools.product(AT_THE_END, ERRORS)), ids=str)
def test_whatever_fails_at_the_end_costs_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception
) -> None:
    check(task, monkeypatch, what, error)


def test_what_a_failed_round_did_is_undone(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last thing that it does fails, after a head was pruned and hidden units were."""
    before: dict[str, Any] = {}

    def worse(context: CompressionContext, *_: Any) -> list[Proposal]:
        gaussians = context.training.gaussians
        before.update({name: value.clone() for name, value in gaussians.model.state_dict().items()})
        before["heads"] = gaussians.model.heads
        width = gaussians.model.settings.hidden_width
        gaussians.optimizer.keep_units(gaussians.model, torch.arange(width // 2))
        return []

    def fails(context: CompressionContext, *_: Any) -> list[Proposal]:
        context.training.gaussians.model.prune_head("means")
        raise RuntimeError("too late")

    monkeypatch.setattr(schedule, "freeze_motion", lambda *_: [])
    monkeypatch.setattr(schedule, "prune_hidden_units", worse)
    monkeypatch.setattr(schedule, "prune_heads", fails)
    list(run_training(replace(task, lossless=True)))
    scene = read_scene(task.output)
    assert "means" in before["heads"] and "means" not in scene.header.model["silent_heads"]
    assert scene.header.model["hidden_width"] == task.recipe.hidden_width
    for name, value in before.items():
        if isinstance(value, torch.Tensor):
            name = name.removeprefix("canonical.").replace("deformation.", "network.")
            np.testing.assert_array_equal(scene.arrays[name], value.numpy())


def test_a_training_goes_on_after_a_round_that_failed(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, (schedule, "prune"), ValueError("no"))
    stream = list(run_training(task))
    assert isinstance(stream[-1], events.Finished)
    (said,) = [event.message for event in stream if isinstance(event, events.WarningEvent)]
    assert said == "Compression at 80 % failed (no). Continuing without it."
    assert [event.step for event in stream if isinstance(event, events.Evaluated)][-1] == STEPS


def test_a_failing_figure_is_told_as_such(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, (Trainer, "evaluate"), MemoryError("no more"))
    *_, end = run_training(task)
    assert isinstance(end, events.Finished) and end.psnr is None
    assert "psnr" not in plays(task).header.metrics


@pytest.mark.parametrize("figure", [float("nan"), float("inf")])
def test_figures_that_no_header_holds_cost_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, figure: float
) -> None:
    monkeypatch.setattr(Trainer, "evaluate", lambda *_: (figure, "held-out"))
    assert isinstance(list(run_training(task))[-1], events.Finished)
    assert plays(task).header.metrics == {"split": "held-out"}


def test_a_second_saving_does_not_see_the_first(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """Building a scene changes neither the figures nor the reductions that it was given."""
    sessions: list[Session] = []
    real = loop.build_scene
    metrics = {"psnr": 12.5, "split": "held-out"}

    def twice(session: Session, given: Metrics) -> BuiltScene:
        sessions.append(session)
        one, other = real(session, metrics), real(session, metrics)
        assert one.scene.header.capacity["reductions"] == [
            {**each, "milliseconds": mine["milliseconds"]}
            for each, mine in zip(
                other.scene.header.capacity["reductions"], one.scene.header.capacity["reductions"], strict=True
            )
        ]
        return one

    monkeypatch.setattr(loop, "build_scene", twice)
    list(run_training(task))
    assert sessions and metrics == {"psnr": 12.5, "split": "held-out"}
