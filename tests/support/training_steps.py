"""Trainings taken step by step, and the least that an optimiser can be tried on."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import torch

from frog_blender.engine.model.canonical import ATTRIBUTES, CanonicalField
from frog_blender.engine.model.interface import SceneModel
from frog_blender.engine.training.compression.context import Compression, compression_of
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.cancel_token import CancelToken
from frog_blender.engine.training.session.events import Event, Progress, WarningEvent
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

Make = Callable[..., Trainer]
"""See ``make_trainer``."""
MakeJob = Callable[..., TrainingJob]
"""See ``make_job``."""


class OnlyGaussians(SceneModel):
    """A method that adds nothing to them."""

    def __init__(self, canonical: CanonicalField) -> None:
        super().__init__()
        self.canonical = canonical


def train(trainer: Trainer, until: int | None = None) -> Trainer:
    """To its end, or until it has taken so many steps."""
    while not trainer.finished and trainer.step_count != until:
        trainer.step()
    return trainer


def bits(trainer: Trainer) -> dict[str, bytes]:
    """Everything that a training has learned and remembers, by name."""
    return {name: value.detach().cpu().numpy().tobytes() for name, value in trainer.state()[0].items()}


def state_of_dynamic(trainer: Trainer) -> dict[str, torch.Tensor]:
    """How its dynamic Gaussians look in the canonical field, by attribute but embeddings."""
    gaussians = trainer.gaussians
    attributes = [(name, getattr(gaussians.canonical, name)) for name in ATTRIBUTES if name != "embeddings"]
    return {name: values.detach()[: gaussians.num_dynamic].clone() for name, values in attributes}


def warnings_of(stream: Iterable[Event]) -> list[str]:
    return [event.message for event in stream if isinstance(event, WarningEvent)]


def compression(trainer: Trainer) -> Compression:
    """Of a training with automatic capacity."""
    context = compression_of(trainer)
    assert context is not None
    return context


def stepping(after: Callable[[Trainer], object]) -> type[Trainer]:
    """Trainers that call ``after`` when a step is done."""

    class Stepping(Trainer):
        def step(self) -> None:
            super().step()
            after(self)

    return Stepping


def cancelled_at(job: TrainingJob, step: int, trainer_type: type[Trainer] = Trainer) -> list[Event]:
    """The events of a training that is cancelled once it has taken so many steps."""
    cancel, stream = CancelToken(), []
    for event in run_training(replace(job, event_seconds=0.0), cancel, trainer_type=trainer_type):
        stream.append(event)
        if isinstance(event, Progress) and event.step >= step:
            cancel.cancel()
    return stream
