"""How a long calculation reports and ends: a progress callback and a question whether to go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[str, float], None]
"""Receives what is being done, as a phrase for a person, and the share of the whole that is done, 0 to 1."""


class SynchronizationCancelled(Exception):
    """The user ended it; nothing was written."""


@dataclass(frozen=True)
class Work:
    """A part of the whole: its share of the progress, and the question that may end it."""

    progress: Progress
    cancelled: Callable[[], bool]
    start: float = 0.0
    end: float = 1.0

    def part(self, start: float, end: float) -> Work:
        """From ``start`` to ``end`` (shares of this part)."""
        length = self.end - self.start
        return Work(self.progress, self.cancelled, self.start + start * length, self.start + end * length)

    def step(self, what: str, done: int, total: int) -> None:
        """Say that ``done`` of ``total`` steps are behind; SynchronizationCancelled if the user ended the work."""
        if self.cancelled():
            raise SynchronizationCancelled
        self.progress(what, self.start + (self.end - self.start) * done / max(total, 1))


def silently() -> Work:
    """For whoever needs no report and cannot cancel."""
    return Work(lambda what, share: None, lambda: False)
