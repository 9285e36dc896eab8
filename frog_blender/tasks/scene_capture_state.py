"""The state of a scene's capture for the panel."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class SceneCaptureState:
    """What the panel shows. Only ``pump()`` writes it, so it needs no lock.

    Attributes:
        folder: of the capture.
        done, total: images that are there, and of the whole capture.
        kept: of those, how many were there before.
        error: one sentence if it failed.
        started: of ``time.monotonic``.
    """

    folder: Path
    total: int
    kept: int = 0
    done: int = 0
    running: bool = True
    cancelled: bool = False
    error: str = ""
    started: float = field(default_factory=time.monotonic)

    @property
    def fraction(self) -> float:
        """How much is done, 0 to 1."""
        return min(self.done / self.total, 1.0) if self.total else 1.0

    def seconds_left(self, now: float) -> float | None:
        """An estimate from the images since the start; None before there is one."""
        rendered = self.done - self.kept
        return (now - self.started) / rendered * (self.total - self.done) if rendered > 0 else None
