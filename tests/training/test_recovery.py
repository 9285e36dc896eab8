"""A training that meets numbers that are none goes back, takes smaller steps, and ends well; or says that it cannot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import filmed as film
import numpy as np
import pytest
import torch

from frog_blender.engine.errors import FrogError
from frog_blender.engine.files import read_scene
from frog_blender.engine.training import events, job
from frog_blender.engine.training import trainer as trainer_module
from frog_blender.engine.training.checkpoint import load_checkpoint, save_checkpoint
from frog_blender.engine.training.job import TrainingJob, run_training
from frog_blender.engine.training.recovery import Recovery
from frog_blender.engine.training.running_loss import Unstable
from frog_blender.engine.training.trainer import Trainer

Make = Callable[..., Trainer]


@pytest.fixture
def task(
    filmed: Path, tmp_path: Path, lively: Callable, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> TrainingJob:
    monkeypatch.setattr(job, "stored_seeds", lambda capture, store, **_: film.seeds())
    return TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(60, dssim_from=0.5), seed=2, device="cpu")


def failing(monkeypatch: pytest.MonkeyPatch, when: Callable[[int], bool]) -> None:
    """The similarity of the D-SSIM bursts, after half of the training, is NaN at the calls that ``when`` names."""
    real, calls = trainer_module.ssim, [0]

    def sometimes(*arguments: torch.Tensor) -> torch.Tensor:
        calls[0] += 1
        return real(*arguments) * (float("nan") if when(calls[0]) else 1.0)

    monkeypatch.setattr(trainer_module, "ssim", sometimes)


def test_one_bad_step_costs_no_training(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, lambda call: call == 3)
    stream = list(run_training(task))
    (warning,) = [event.message for event in stream if isinstance(event, events.Warned)]
    assert "unstable at step 52" in warning and "goes on from step 48 with steps of half the size" in warning
    assert isinstance(stream[-1], events.Finished) and stream[-1].steps == 60
    assert all(np.isfinite(array).all() for array in read_scene(task.output).arrays.values())


def test_what_never_gets_better_ends_in_a_sentence(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, lambda call: True)
    said = []
    with pytest.raises(FrogError, match="unstable at step"):
        said.extend(run_training(task))
        pytest.fail("it came to an end")
    said = []
    stream = run_training(task)
    with pytest.raises(FrogError):
        for event in stream:
            said.append(event)
    assert sum(isinstance(event, events.Warned) for event in said) == 3


def test_going_back_restores_every_bit(make_trainer: Make, bits: Callable, tmp_path: Path) -> None:
    trainer = make_trainer(60)
    while trainer.step_count < 20:
        trainer.step()
    recovery, before = Recovery(trainer), bits(trainer)
    while trainer.step_count < 33:  # past a round that brings Gaussians
        trainer.step()
    assert bits(trainer) != before
    assert "step 20" in recovery.go_back(trainer, Unstable("Training became unstable."))
    assert bits(trainer) == before and trainer.step_count == 20
    assert trainer.optimizer.rate_factor == 0.5
    recovery.go_back(trainer, Unstable("Again."))
    assert trainer.optimizer.rate_factor == 0.25  # smaller each time
    trainer.step()
    assert trainer.optimizer.adam.param_groups[0]["lr"] > 0
    save_checkpoint(tmp_path / "c", trainer)
    other = make_trainer(60)
    load_checkpoint(tmp_path / "c", other)
    assert other.optimizer.rate_factor == 0.25


def test_a_model_that_is_not_finite_is_not_remembered(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    trainer.step()
    recovery = Recovery(trainer)
    trainer.model.canonical.embeddings.data[3, 1] = float("nan")
    with pytest.raises(Unstable, match="embeddings is not finite"):
        recovery.remember(trainer)
    recovery.go_back(trainer, Unstable("x"))
    assert torch.isfinite(trainer.model.canonical.embeddings).all()
