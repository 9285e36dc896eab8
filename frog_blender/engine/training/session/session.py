"""One run of a training job: what the steps, previews, checkpoints and the export share."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
from dataclasses import dataclass, field
from pathlib import Path

from ...capture.capture import Capture
from ..optimize.peers import Peers
from ..optimize.trainer import Trainer
from .cancel_token import CancelToken
from .job import TrainingJob
from .time_estimate import PhaseClock


@dataclass(frozen=True)
class Session:
    """A training job at work.

    Attributes:
        job: what was asked for.
        trainer: the training's state.
        scale: image size factor that the job's scale came to.
        cancel: what the front end asks of the training.
        clock: how long each phase took.
    """

    job: TrainingJob
    trainer: Trainer
    scale: float = 1.0
    cancel: CancelToken = field(default_factory=CancelToken)
    clock: PhaseClock = field(default_factory=lambda: PhaseClock(CancelToken()))

    @property
    def peers(self) -> Peers:
        """The processes of this training."""
        return self.trainer.peers

    @property
    def capture(self) -> Capture:
        """With the cameras as they are refined so far."""
        return self.trainer.capture

    @property
    def output(self) -> Path:
        """Where the scene is to lie."""
        return self.job.output
