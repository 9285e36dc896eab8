"""Trainings taken step by step, and the least that an optimiser can be tried on."""

from __future__ import annotations

from frog_blender.engine.model.canonical import CanonicalField
from frog_blender.engine.model.interface import SceneModel
from frog_blender.engine.training.compression.context import CompressionContext
from frog_blender.engine.training.compression.schedule import compression_of
from frog_blender.engine.training.optimize.trainer import Trainer


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


def compression(trainer: Trainer) -> CompressionContext:
    """Of a training with automatic capacity."""
    found = compression_of(trainer)
    assert found is not None
    return found
