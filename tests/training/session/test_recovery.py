"""Steps that diverge, and what a training may leave undone: whatever fails, what was learned plays."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.builders import refused
from support.training_steps import Make, MakeJob, bits, cancelled_at, stepping, train, warnings_of

from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.compression import schedule
from frog_blender.engine.training.compression.context import Compression
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.training import TrainingDiverged
from frog_blender.engine.training.session import events, export, loop
from frog_blender.engine.training.session.checkpoint import restore, state_of
from frog_blender.engine.training.session.export import Metrics, build_scene
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.recovery import Recovery
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.session import Session


@pytest.fixture
def task(make_job: MakeJob) -> TrainingJob:
    return make_job(60, dssim_from=0.5)


def failing(when: Callable[[int], bool]) -> type[Trainer]:
    """Trainers whose images of the D-SSIM bursts, after half of the training, are NaN in the steps that ``when`` names;
    steps taken again count on."""
    steps = [0]

    class Failing(Trainer):
        def draw(self, shot_index: int, progress: float, options: RasterizeOptions, *more: Any) -> Any:
            truth, drawn = super().draw(shot_index, progress, options, *more)
            if not options.depth and progress >= 0.5:
                steps[0] += 1
                if when(steps[0]):
                    drawn.image.rgb = drawn.image.rgb * float("nan")
            return truth, drawn

    return Failing


def test_one_bad_step_costs_no_training(task: TrainingJob) -> None:
    stream = list(run_training(task, trainer_type=failing(lambda step: step == 23)))
    (warning,) = warnings_of(stream)
    assert "unstable at step 52" in warning and "Continuing from step 48 with steps of half the size" in warning
    assert isinstance(stream[-1], events.Finished) and stream[-1].steps == 60
    assert all(np.isfinite(array).all() for array in read_scene(task.output).arrays.values())


def test_what_never_gets_better_ends_in_a_sentence(task: TrainingJob) -> None:
    said = []
    refused("unstable at step", said.extend, run_training(task, trainer_type=failing(lambda step: True)))
    assert len(warnings_of(said)) == 3


def test_going_back_restores_every_bit(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    train(trainer, until=20)
    recovery, before = Recovery(trainer), bits(trainer)
    train(trainer, until=33)  # past a round that brings Gaussians
    assert bits(trainer) != before
    assert "step 20" in recovery.rollback(TrainingDiverged("Training became unstable."))
    assert bits(trainer) == before and trainer.step_count == 20
    assert trainer.optimizer.rate_factor == 0.5
    recovery.rollback(TrainingDiverged("Again."))
    assert trainer.optimizer.rate_factor == 0.25  # smaller each time
    trainer.step()
    assert trainer.optimizer.adam.param_groups[0]["lr"] > 0
    other = make_trainer(60)
    restore(other, state_of(trainer))
    assert other.optimizer.rate_factor == 0.25


def test_a_model_that_is_not_finite_is_not_remembered(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    trainer.step()
    recovery = Recovery(trainer)
    trainer.model.canonical.embeddings.data[3, 1] = float("nan")
    with pytest.raises(TrainingDiverged, match="embeddings is not finite"):
        recovery.snapshot()
    recovery.rollback(TrainingDiverged("x"))
    assert torch.isfinite(trainer.model.canonical.embeddings).all()


def losing_a_gaussian(at: int) -> type[Trainer]:
    """Trainers that after step ``at``, the first time, have a Gaussian of NaN, which no image and no loss shows."""
    done = [False]

    def lose(trainer: Trainer) -> None:
        if trainer.step_count == at and not done[0]:
            done[0] = True
            trainer.model.canonical.means.data[3, 1] = float("nan")

    return stepping(lose)


class LateLoss(Trainer):
    """Whose loss was NaN at step 23, which is found when it is looked for."""

    def check(self) -> None:
        super().check()
        if self.step_count == 23:
            raise TrainingDiverged("Training became unstable at step 23 (the loss is not a number).")


def finite(checkpoint: Path) -> bool:
    arrays, _ = read_tensors(checkpoint, "a training checkpoint")
    return all(np.isfinite(array).all() for name, array in arrays.items() if name.startswith("model."))


def test_no_checkpoint_holds_numbers_that_are_none(task: TrainingJob) -> None:
    seen, stream = [], run_training(replace(task, save_every=0.0), trainer_type=losing_a_gaussian(8))
    for event in stream:
        if checkpoint_path(task.output).is_file():
            seen.append(finite(checkpoint_path(task.output)))
        if isinstance(event, events.WarningEvent):
            assert "means is not finite" in event.message and "Continuing from step 7 " in event.message
    assert isinstance(event, events.Finished) and event.steps == 60
    assert len(seen) > 60 and all(seen)


@pytest.mark.parametrize("trainer_type", [losing_a_gaussian(23), LateLoss], ids=["a Gaussian", "the loss"])
def test_a_cancelled_training_goes_back_too(task: TrainingJob, trainer_type: type[Trainer]) -> None:
    """As on a GPU, where a loss of NaN is seen steps later: nobody looked before the training was cancelled."""
    stream = cancelled_at(task, 23, trainer_type)
    assert warnings_of(stream)
    assert stream[-1] == events.Cancelled(18, str(task.output)) and finite(checkpoint_path(task.output))
    assert read_scene(task.output).header.steps == 18
    assert list(run_training(replace(task, resume=True)))[-1].steps == 60


def test_what_a_bad_image_said_of_its_regions_is_forgotten(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    train(trainer, until=12)
    recovery = Recovery(trainer)
    camera, shape = trainer.capture.cameras[1], trainer.crops.errors[1].shape
    trainer.crops.observe(1, (0, 0, camera.width, camera.height), torch.full(shape, torch.nan))
    recovery.rollback(TrainingDiverged("x"))
    trainer.synchronize()
    assert all(not np.isnan(errors).any() for errors in trainer.crops.errors)
    np.testing.assert_array_equal(trainer.crops.errors[1], recovery.last_state[0]["regions.1"])


STEPS = 20
ERRORS = [
    RuntimeError("torch does not like this"),
    np.linalg.LinAlgError("singular matrix"),
    ValueError("cannot convert float NaN to integer\nand more"),
    MemoryError(),
]
AT_THE_END = [
    *((schedule, name) for name in ("prune_unmissed", "freeze_motion")),
    (Compression, "mean_dynamic_state"),
    *((export, name) for name in ("reorder_for_playback", "packing_step")),
    (loop, "fit_budget"),
    (Trainer, "evaluate"),
]
ON_THE_WAY = [(schedule, "prune")]


def name_of(value: Any) -> str | None:
    return value[1] if isinstance(value, tuple) else None


@pytest.fixture
def brief_task(make_job: MakeJob) -> TrainingJob:
    return make_job(STEPS, capacity="auto")


def broken(monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception) -> None:
    """Lets ``what`` fail; what is done in the middle of a training as well, only at its end."""
    owner, name = what
    real = getattr(owner, name)

    def fails(*arguments: Any, **options: Any) -> Any:
        first = arguments[0]
        training = first.training if isinstance(first, Compression) else first
        if name == "evaluate" and not training.finished:
            return real(*arguments, **options)
        raise error

    monkeypatch.setattr(owner, name, fails)


def plays(task: TrainingJob) -> ScenePlayer:
    """The scene that lies where the job wants it, played at some times."""
    scene = ScenePlayer.load(task.output)
    for time in (0.0, 0.4, 1.0):
        assert all(np.isfinite(values).all() for values in scene.at(time).arrays.values())
    return scene


@pytest.mark.parametrize(("index", "what"), list(enumerate([*AT_THE_END, *ON_THE_WAY])), ids=name_of)
def test_a_pass_that_fails_costs_no_scene(
    brief_task: TrainingJob, monkeypatch: pytest.MonkeyPatch, index: int, what: tuple[Any, str]
) -> None:
    errors = ERRORS if what in AT_THE_END else ERRORS[:3]  # memory that ends in the middle costs Gaussians
    broken(monkeypatch, what, errors[index % len(errors)])
    stream = list(run_training(brief_task))
    said = warnings_of(stream)
    assert isinstance(stream[-1], events.Finished) and plays(brief_task).header.steps == STEPS
    assert (stream[-1].psnr is None) == (what[1] == "evaluate") == ("psnr" not in plays(brief_task).header.metrics)
    assert len(said) == 1 and said[0].endswith(".") and "\n" not in said[0]
    assert [event.step for event in stream if isinstance(event, events.Evaluated)][-1:] in ([STEPS], [18])


def test_what_a_failed_milestone_did_is_undone(brief_task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """It fails after half of the Gaussians were pruned."""
    before: dict[str, torch.Tensor] = {}

    class Watched(Trainer):
        def before_milestone(self) -> None:
            super().before_milestone()
            before.update({name: value.clone() for name, value in self.model.state_dict().items()})

    def fails(context: Compression, *_: Any) -> None:
        gaussians = context.training.gaussians
        gaussians.keep(torch.arange(gaussians.count // 2, device=gaussians.device))
        raise RuntimeError("too late")

    monkeypatch.setattr(schedule, "prune_unmissed", fails)
    list(run_training(replace(brief_task, lossless=True), trainer_type=Watched))
    scene = read_scene(brief_task.output)
    for name, value in before.items():
        name = name.removeprefix("canonical.").replace("deformation.", "network.")
        np.testing.assert_array_equal(scene.arrays[name], value.numpy())


def test_a_figure_that_no_header_holds_costs_no_scene(brief_task: TrainingJob) -> None:
    class Measured(Trainer):
        def evaluate(self, *_: object) -> tuple[float, str]:
            return float("inf"), "held-out"

    assert isinstance(list(run_training(brief_task, trainer_type=Measured))[-1], events.Finished)
    assert plays(brief_task).header.metrics == {"split": "held-out"}


def test_a_second_saving_does_not_see_the_first(brief_task: TrainingJob, make_trainer: Make) -> None:
    """Building a scene changes neither the figures nor the reductions that it was given."""
    session = Session(brief_task, train(make_trainer(STEPS, capacity="auto")))
    metrics: Metrics = {"psnr": 12.5, "split": "held-out"}
    one, other = (build_scene(session, metrics)[0].header.capacity["reductions"] for _ in range(2))
    assert one and one == other
    assert metrics == {"psnr": 12.5, "split": "held-out"}
