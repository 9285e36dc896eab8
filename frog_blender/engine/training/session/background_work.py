"""Work before training, in a thread of its own: its reports become events, and it can be cancelled."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator
from typing import Generic, TypeVar

from .events import Event, Stage

Result = TypeVar("Result")
_MAX_WAIT = 10.0  # seconds for abandoned work to end


class _Abandoned(Exception):
    """Ends the work at its next report."""


class _Worker(threading.Thread, Generic[Result]):
    """Runs ``work(report)``; then holds its result, or the error that it raised."""

    def __init__(
        self, name: str, work: Callable[[Callable[[int, int], None]], Result], cancelled: Callable[[], bool]
    ) -> None:
        super().__init__(name=f"frog: {name}", daemon=True)
        self._work, self._cancelled = work, cancelled
        self.reports: queue.Queue[tuple[int, int]] = queue.Queue()
        self.result: Result | None = None
        self.error: BaseException | None = None
        self.abandoned = threading.Event()

    def _report(self, done: int, total: int) -> None:
        if self.abandoned.is_set() or self._cancelled():
            raise _Abandoned
        self.reports.put((done, total))

    def run(self) -> None:
        try:
            self.result = self._work(self._report)
        except BaseException as error:
            self.error = error


def in_background(
    name: str, work: Callable[[Callable[[int, int], None]], Result], cancelled: Callable[[], bool]
) -> Generator[Event, None, Result | None]:
    """Runs ``work(report)`` in a thread, yields its reports as Stage events and returns its result; None if cancelled.

    Raises:
        Exception: what ``work`` raised, unless it was cancelled.
    """
    worker = _Worker(name, work, cancelled)
    worker.start()
    try:
        while worker.is_alive() or not worker.reports.empty():
            try:
                done, total = worker.reports.get(timeout=0.1)
            except queue.Empty:
                continue
            while not worker.reports.empty():  # only the newest matters
                done, total = worker.reports.get_nowait()
            yield Stage(name, done, total)
    finally:  # nothing half-made is left when the caller stops listening
        worker.abandoned.set()
        worker.join(_MAX_WAIT)
    if cancelled():
        return None
    if worker.error is not None:
        raise worker.error
    return worker.result
