"""The state of a calibration for the panel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..engine.capture.calibration.pipeline import Outcome

_MANY = 500


@dataclass
class CalibrationState:
    """What the panel shows.  Only ``pump()`` writes it, so it needs no lock.

    Attributes:
        folder: of the videos.
        stage, done, total: what is being done, and how much of how much of it is done.
        outcome: what was written, if it succeeded.
        error: one sentence if it did not; for footage that does not fix its cameras it says what to film next time.
        is_refused: the error is such a refusal, not a failure.
    """

    folder: Path
    running: bool = True
    stage: str = "Starting"
    done: int = 0
    total: int = 0
    outcome: Outcome | None = None
    cancelled: bool = False
    error: str = ""
    is_refused: bool = False

    @property
    def fraction(self) -> float:
        """How much of the present stage is done, 0 to 1."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else 0.0

    @property
    def doing(self) -> str:
        """The present stage in words; of many parts, which are shares of it, in percent."""
        stage = self.stage[:1].upper() + self.stage[1:]
        if self.total >= _MANY:
            return f"{stage}: {100 * self.fraction:.0f} %"
        return f"{stage}: {self.done:,} of {self.total:,}" if self.total > 1 else stage
