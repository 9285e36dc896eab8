"""Trainings taken step by step."""

from __future__ import annotations

from frog_blender.engine.training.trainer import Trainer


def train(trainer: Trainer, until: int | None = None) -> Trainer:
    """To its end, or until it has taken so many steps."""
    while not trainer.finished and trainer.step_count != until:
        trainer.step()
    return trainer
