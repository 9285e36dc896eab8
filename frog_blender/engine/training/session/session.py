"""One run of a training job: what the steps, previews, checkpoints and the export share."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
from dataclasses import dataclass, field
from pathlib import Path

from ...capture.capture import Capture
from ..optimize.trainer import Trainer
from ..recipe import Recipe
from .cancel_token import CancelToken
from .job import TrainingJob
from .output_paths import checkpoint_path


@dataclass(frozen=True)
class Session:
    """A training job at work.

    Attributes:
        job: what was asked for.
        trainer: the training's state.
        scale: image size factor that the job's scale came to.
        cancel: what the front end asks of the training.
    """

    job: TrainingJob
    trainer: Trainer
    scale: float = 1.0
    cancel: CancelToken = field(default_factory=CancelToken)

    @property
    def capture(self) -> Capture:
        """With the cameras as they are refined so far."""
        return self.trainer.capture

    @property
    def recipe(self) -> Recipe:
        """As the method adapted it, and as memory limits it."""
        return self.trainer.recipe

    @property
    def output(self) -> Path:
        """Where the scene is to lie."""
        return self.job.output

    @property
    def checkpoint(self) -> Path:
        """Where the checkpoint lies."""
        return checkpoint_path(self.job.output)
