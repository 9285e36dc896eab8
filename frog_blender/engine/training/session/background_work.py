"""Work before training, in a thread of its own: its reports become events, and it can be cancelled."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future
from typing import TypeVar

from .events import Event, Stage

Result = TypeVar("Result")
_MAX_WAIT = 10.0  # seconds for abandoned work to end


class _Abandoned(Exception):
    """Ends the work at its next report."""


def in_background(
    name: str, work: Callable[[Callable[[int, int], None]], Result], cancelled: Callable[[], bool]
) -> Generator[Event, None, Result | None]:
    """Runs ``work(report)`` in a thread, yields its reports as Stage events and returns its result; None if cancelled.

    Raises:
        Exception: what ``work`` raised, unless it was cancelled.
    """
    reports: queue.Queue[tuple[int, int]] = queue.Queue()
    abandoned, outcome = threading.Event(), Future[Result]()

    def report(done: int, total: int) -> None:
        if abandoned.is_set() or cancelled():
            raise _Abandoned
        reports.put((done, total))

    def run() -> None:
        try:
            outcome.set_result(work(report))
        except BaseException as error:
            outcome.set_exception(error)

    worker = threading.Thread(target=run, name=f"frog: {name}", daemon=True)
    worker.start()
    try:
        while worker.is_alive() or not reports.empty():
            try:
                done, total = reports.get(timeout=0.1)
            except queue.Empty:
                continue
            while not reports.empty():  # only the newest matters
                done, total = reports.get_nowait()
            yield Stage(name, done, total)
    finally:  # nothing half-made is left when the caller stops listening
        abandoned.set()
        worker.join(_MAX_WAIT)
    return None if cancelled() else outcome.result()
