"""A trainer with everything that its recipe asks for."""

from __future__ import annotations

from . import passive_threads  # noqa: F401

# isort: split
import torch

from ..capture.capture import Capture
from ..capture.frames import FrameStore
from ..capture.seeds import Seeds
from .compression.schedule import CompressionSchedule
from .compression.settings import DEFAULT, CompressionSettings
from .optimize.trainer import Limits, Trainer
from .recipe import Recipe


def build_trainer(
    capture: Capture,
    store: FrameStore,
    seeds: Seeds,
    recipe: Recipe,
    method: str,
    limits: Limits,
    *,
    seed: int,
    device: torch.device | str = "cpu",
    compression: CompressionSettings = DEFAULT,
) -> Trainer:
    """See Trainer; ``compression`` counts where the recipe, as the method adapts it, has automatic capacity."""
    trainer = Trainer(capture, store, seeds, recipe, method, limits, seed=seed, device=device)
    if trainer.recipe.capacity == "auto":
        trainer.add_hook(CompressionSchedule(capture, seed, compression))
    return trainer
