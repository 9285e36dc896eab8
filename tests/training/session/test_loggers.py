"""What loggers are told, and the sinks of examples/loggers."""

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, call

import numpy as np
import pytest
from support.builders import REPOSITORY, refused

from frog_blender.engine.registry import SINKS
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

TOLD = (
    events.Stage("Decoding frames", 0, 1),
    events.Progress(7, 10, 1.0, 2.0, 0.25, 100, 40),
    events.Statistics(7, {"l1": 0.125}, {"means": 1e-3}, 9, 4),
    events.Evaluated(7, 30.0, "held-out"),
    events.Preview(7, np.zeros((2, 3, 3), np.uint8)),
    events.Finished("x.frog", 10, 1.0, 30.0, 100),
)
FIGURES = {
    "loss/mean": 0.25,
    "gaussians/all": 100,
    "gaussians/dynamic": 40,
    "time/seconds": 1.0,
    "loss/l1": 0.125,
    "rate/means": 1e-3,
    "gaussians/added": 9,
    "gaussians/removed": 4,
    "psnr_db/held-out": 30.0,
}


def test_losses_rates_and_counts(make_job: Callable[..., TrainingJob]) -> None:
    stream = list(run_training(make_job(40)))
    told = [event for event in stream if isinstance(event, events.Statistics)]
    progress = [event for event in stream if isinstance(event, events.Progress)]
    started = next(event for event in stream if isinstance(event, events.Started))
    assert [event.step for event in told] == [event.step for event in progress]
    for event, then in zip(told, progress, strict=True):
        assert event.losses["l1"] > 0 and event.rates["means"] >= 0 and event.rates["network"] >= 0
        assert started.gaussians + event.added - event.removed == then.gaussians
    assert told[-1].added > 0
    assert json.loads(events.line_of(told[-1])) == {"event": "statistics", **vars(told[-1])}


def test_a_step_s_terms_are_its_loss(make_job: Callable[..., TrainingJob]) -> None:
    """Of one step alone: later the loss that is told is a running mean."""
    stream = list(run_training(make_job(1)))
    terms = next(event.losses for event in stream if isinstance(event, events.Statistics))
    loss = next(event.loss for event in stream if isinstance(event, events.Progress))
    assert sum(terms.values()) == pytest.approx(loss, rel=1e-5)


@pytest.fixture
def loggers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / "examples" / "loggers")
    for name in [name for name in sys.modules if name.startswith("frog_loggers")]:
        monkeypatch.delitem(sys.modules, name)


def test_tensorboard(loggers: None, monkeypatch: pytest.MonkeyPatch) -> None:
    board = MagicMock()
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", board)
    sink = importlib.import_module("frog_loggers.tensorboard").Sink("there")
    for event in TOLD:
        sink(event)
    figures = [call.add_scalar(name, value, 7) for name, value in FIGURES.items()]
    image = call.add_image("preview", TOLD[4].image, 7, dataformats="HWC")
    board.SummaryWriter.assert_called_once_with("there")
    assert board.SummaryWriter().mock_calls == [*figures, image, call.close()]


def test_wandb(loggers: None, monkeypatch: pytest.MonkeyPatch) -> None:
    wrote: dict[str, Any] = {}
    run = SimpleNamespace(log=lambda figures, step: wrote.update(figures), finish=lambda: wrote.update(finished=True))
    stub = ModuleType("wandb")
    stub.init, stub.Image = lambda: run, lambda image: image.shape  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "wandb", stub)
    sink = importlib.import_module("frog_loggers.wandb").Sink()
    for event in TOLD:
        sink(event)
    assert wrote == FIGURES | {"preview": (2, 3, 3), "finished": True}


@pytest.mark.parametrize(("name", "module"), [("tensorboard", "torch.utils.tensorboard"), ("wandb", "wandb")])
def test_what_is_missing_is_named_before_anything_is_decoded(
    name: str, module: str, loggers: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, filmed: Path
) -> None:
    monkeypatch.setitem(sys.modules, module, None)  # importing it fails
    SINKS.register(name, f"frog_loggers.{name}:SINK")
    try:
        job = TrainingJob(filmed, tmp_path / "x.frog", sinks=(name,))
        refused(rf"package '{name}' is missing; pip install {name} brings it", next, iter(run_training(job)))
    finally:
        SINKS.unregister(name)
