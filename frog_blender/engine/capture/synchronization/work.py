"""How a long calculation reports and ends: a progress callback and a question whether to go on."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from ...arrays import Array
from ...io.child_process import Stopped

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

Progress = Callable[[str, float], None]
"""Receives what is being done, as a phrase for a person, and the share of the whole that is done, 0 to 1."""


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

    def parts(self, count: int) -> list[Work]:
        """So many equal parts."""
        return [self.part(index / count, (index + 1) / count) for index in range(count)]

    def step(self, what: str, done: int, total: int) -> None:
        """Say that ``done`` of ``total`` steps are behind; Stopped if the user ended the work."""
        if self.cancelled():
            raise Stopped
        self.progress(what, self.start + (self.end - self.start) * done / max(total, 1))


def forward_only(progress: Progress) -> Progress:
    """The same for several threads, which do not end in order: the share never falls."""
    lock, most = threading.Lock(), 0.0

    def told(what: str, share: float) -> None:
        nonlocal most
        with lock:
            most = max(most, share)
            progress(what, most)

    return told


class Kept(Protocol):
    """Keeps arrays by a stage's name and a key, for a second synchronisation of the same films."""

    def load(self, stage: str, key: str) -> dict[str, Array] | None: ...

    def keep(self, stage: str, key: str, arrays: Mapping[str, Array]) -> Path: ...


def in_threads(function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """The results in order; OpenCV decodes and computes outside Python's lock, and numpy in part."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return list(threads.map(function, items))
