"""One run of a training job: what the steps, previews, checkpoints and the export share."""

import time
from dataclasses import dataclass, field

from ...capture.capture import Capture
from ..optimize.trainer import Trainer
from .cancel_token import CancelToken
from .job import TrainingJob


class PhaseClock:
    """Measures phases that follow each other, without pauses.

    Attributes:
        cancel: tells of pauses.
        seconds: of each phase that has ended, by its name.
    """

    def __init__(self, cancel: CancelToken) -> None:
        self.cancel = cancel
        self.seconds: dict[str, float] = {}
        self._began = self.now()

    def now(self) -> float:
        """Seconds on a clock that stands still during pauses."""
        return time.perf_counter() - self.cancel.seconds_paused

    def end(self, phase: str) -> None:
        """A phase has ended, and the next one begins."""
        self.seconds[phase], self._began = self.now() - self._began, self.now()


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
    def capture(self) -> Capture:
        """With the cameras as they are refined so far."""
        return self.trainer.capture
