"""A training that diverges is rolled back, takes smaller steps, and ends well; or says that it cannot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.training_steps import train

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize import losses
from frog_blender.engine.training.optimize.running_loss import TrainingDiverged
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session import run as training_run
from frog_blender.engine.training.session.checkpoint import checkpoint_path, load_checkpoint, save_checkpoint
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.recovery import Recovery
from frog_blender.engine.training.session.run import run_training

Make = Callable[..., Trainer]


@pytest.fixture
def task(
    filmed: Path, tmp_path: Path, lively: Callable, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> TrainingJob:
    monkeypatch.setattr(training_run, "stored_seeds", lambda capture, store, **_: film.seeds())
    return TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(60, dssim_from=0.5), seed=2, device="cpu")


def failing(monkeypatch: pytest.MonkeyPatch, when: Callable[[int], bool]) -> None:
    """The similarity of the D-SSIM bursts, after half of the training, is NaN at the calls that ``when`` names."""
    real, calls = losses.native_ssim, [0]

    def sometimes(*arguments: torch.Tensor) -> float:
        calls[0] += 1
        return real(*arguments) * (float("nan") if when(calls[0]) else 1.0)

    monkeypatch.setattr(losses, "native_ssim", sometimes)


def test_one_bad_step_costs_no_training(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, lambda call: call == 3)
    stream = list(run_training(task))
    (warning,) = [event.message for event in stream if isinstance(event, events.WarningEvent)]
    assert "unstable at step 52" in warning and "Continuing from step 48 with steps of half the size" in warning
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
    assert sum(isinstance(event, events.WarningEvent) for event in said) == 3


def test_going_back_restores_every_bit(make_trainer: Make, bits: Callable, tmp_path: Path) -> None:
    trainer = make_trainer(60)
    train(trainer, until=20)
    recovery, before = Recovery(trainer), bits(trainer)
    train(trainer, until=33)  # past a round that brings Gaussians
    assert bits(trainer) != before
    assert "step 20" in recovery.rollback(trainer, TrainingDiverged("Training became unstable."))
    assert bits(trainer) == before and trainer.step_count == 20
    assert trainer.optimizer.rate_factor == 0.5
    recovery.rollback(trainer, TrainingDiverged("Again."))
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
    with pytest.raises(TrainingDiverged, match="embeddings is not finite"):
        recovery.snapshot(trainer)
    recovery.rollback(trainer, TrainingDiverged("x"))
    assert torch.isfinite(trainer.model.canonical.embeddings).all()


def losing_a_gaussian(monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    """After step ``at``, the first time, a Gaussian is none, which no image and no loss shows."""
    step, done = Trainer.step, [False]

    def sometimes(self: Trainer) -> None:
        step(self)
        if self.step_count == at and not done[0]:
            done[0] = True
            self.model.canonical.means.data[3, 1] = float("nan")

    monkeypatch.setattr(Trainer, "step", sometimes)


def finite(checkpoint: Path) -> bool:
    arrays, _ = read_tensors(checkpoint, "a training checkpoint")
    return all(np.isfinite(array).all() for name, array in arrays.items() if name.startswith("model."))


def test_no_checkpoint_holds_numbers_that_are_none(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    losing_a_gaussian(monkeypatch, 8)
    seen, stream = [], run_training(replace(task, save_seconds=0.0))
    for event in stream:
        if checkpoint_path(task.output).is_file():
            seen.append(finite(checkpoint_path(task.output)))
        if isinstance(event, events.WarningEvent):
            assert "means is not finite" in event.message and "Continuing from step 7 " in event.message
    assert isinstance(event, events.Finished) and event.steps == 60
    assert len(seen) > 60 and all(seen)


@pytest.mark.parametrize("lost", ["a Gaussian", "the loss"])
def test_a_cancelled_training_goes_back_too(task: TrainingJob, monkeypatch: pytest.MonkeyPatch, lost: str) -> None:
    """As on a GPU, where a loss that is none is seen steps later: nobody looked before the training was cancelled."""
    step, taken = Trainer.step, [0]

    def counted(self: Trainer) -> None:
        step(self)
        taken[0] += 1
        if self.step_count == 23 and lost == "a Gaussian":
            self.model.canonical.means.data[3, 1] = float("nan")
        elif self.step_count == 23:
            self._loss._mean, self._loss._unseen = torch.tensor(float("nan")), 1

    monkeypatch.setattr(Trainer, "step", counted)
    stream = list(run_training(task, lambda: taken[0] >= 23))
    assert [event for event in stream if isinstance(event, events.WarningEvent)]
    assert stream[-1] == events.Cancelled(18, str(task.output)) and finite(checkpoint_path(task.output))
    assert read_scene(task.output).header.steps == 18
    taken[0] = -100
    monkeypatch.setattr(Trainer, "step", step)
    assert list(run_training(replace(task, resume=True)))[-1].steps == 60


def test_a_state_that_is_not_finite_is_never_what_is_gone_back_to(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    trainer.model.canonical.sh.data[0, 0, 0] = float("inf")
    with pytest.raises(TrainingDiverged, match="sh is not finite"):
        Recovery(trainer)


def test_what_a_bad_image_said_of_its_regions_is_forgotten(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    train(trainer, until=12)
    recovery = Recovery(trainer)
    camera, shape = trainer.capture.cameras[1], trainer.crops.errors[1].shape
    trainer.crops.observe(1, (0, 0, camera.width, camera.height), torch.full(shape, torch.nan))
    recovery.rollback(trainer, TrainingDiverged("x"))
    trainer.synchronize()
    assert all(not np.isnan(errors).any() for errors in trainer.crops.errors)
    np.testing.assert_array_equal(trainer.crops.errors[1], recovery.last_state[0]["regions.1"])
