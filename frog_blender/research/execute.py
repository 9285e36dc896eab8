"""Runs a grid: does what is not done yet, one run at a time or several at once, and writes each result."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..engine import FrogError
from .grid import Run
from .results import Record, append, finished, locked, read
from .runs import RunEnvironment, Stopped, clean_up, failure, frog_seconds, is_done, perform
from .workers import Answers, Workers, Working

Perform = Callable[[Run, RunEnvironment, float | None, Callable[[float], None], Callable[[], bool]], Record]
"""Does one run; see ``runs.perform``."""


@dataclass
class Progress:
    """How far a grid is; handed to the caller at every change.

    Attributes:
        total, done, failed: numbers of runs; ``done`` includes those that were done before.
        shares: of the runs in progress, the share that is done, by run.
        seconds_left: an estimate from the mean durations of finished runs; None before the first.
        record: the result that was just written; None otherwise.
    """

    total: int
    done: int = 0
    failed: int = 0
    shares: dict[Run, float] = field(default_factory=dict)
    seconds_left: float | None = None
    record: Record | None = None


@dataclass(frozen=True)
class GridCallbacks:
    """What a grid calls while it runs.

    Attributes:
        progressed: called with the progress at every change.
        cancelled: asked whether to stop.
        perform: does one run where ``jobs`` is 1.
    """

    progressed: Callable[[Progress], None] = lambda progress: None
    cancelled: Callable[[], bool] = lambda: False
    perform: Perform = perform


def run_grid(
    runs: Sequence[Run],
    environment: RunEnvironment,
    *,
    workers: Workers | None = None,
    callbacks: GridCallbacks | None = None,
) -> Progress:
    """Does in order every run that is not ``is_done`` yet; a run that fails is recorded, and the next one begins.

    Args:
        workers: who does the runs, several at once; this process, one after the other, if None.

    Raises:
        Stopped: if it was cancelled; the runs in progress continue next time.
    """
    records = read(environment.results)
    waiting = [run for run in runs if not is_done(run, records)]
    progress = Progress(len(runs), len(runs) - len(waiting))
    if workers is not None:
        environment = replace(environment, threads=workers.threads, dedicated=False)
    _keep_out_of_repositories(environment.folder / "scenes")
    with locked(environment.folder / "scenes" / "lock"):
        _Grid(waiting, environment, workers, progress, callbacks or GridCallbacks()).work()
    return progress


def _keep_out_of_repositories(scenes: Path) -> None:
    """Git ignores scenes and checkpoints, which are large and can be made again, but not the results beside them."""
    try:
        scenes.mkdir(parents=True, exist_ok=True)
        (scenes / ".gitignore").write_text("*\n", encoding="utf-8")
    except OSError as error:
        raise FrogError(f"{scenes}: the folder could not be made ({error.strerror}).") from error


class _Grid:
    """The runs that wait and those in progress."""

    def __init__(
        self,
        waiting: list[Run],
        environment: RunEnvironment,
        workers: Workers | None,
        progress: Progress,
        callbacks: GridCallbacks,
    ) -> None:
        self._waiting, self._environment, self._workers = waiting, environment, workers
        self._progress, self._callbacks = progress, callbacks
        self._records = read(environment.results)

    def work(self) -> None:
        self._report()
        if self._workers is not None:
            self._by(self._workers)
        else:
            while self._waiting:
                self._here(self._waiting.pop(0))

    def _report(self, record: Record | None = None) -> None:
        jobs = 1 if self._workers is None else self._workers.jobs
        left = seconds_left(self._waiting, self._progress.shares, self._records, jobs)
        self._progress.seconds_left = left
        self._progress.record = record
        self._callbacks.progressed(self._progress)

    def _advanced(self, run: Run, share: float) -> None:
        self._progress.shares[run] = share
        self._report()

    def _ended(self, run: Run, record: Record) -> None:
        append(self._environment.results, record)
        self._records.append(record)
        self._progress.shares.pop(run, None)
        if record["kind"] == "run":
            clean_up(run, self._environment)
            self._progress.done += 1
        else:
            self._progress.failed += 1
        self._report(record)

    def _seconds(self, run: Run) -> float | None:
        return frog_seconds(run, self._records, self._environment) if run.equal_time else None

    def _here(self, run: Run) -> None:
        if self._callbacks.cancelled():
            raise Stopped
        self._advanced(run, 0.0)
        try:
            seconds = self._seconds(run)
            record = self._callbacks.perform(
                run, self._environment, seconds, lambda share: self._advanced(run, share), self._callbacks.cancelled
            )
        except (FrogError, MemoryError, ImportError) as error:
            record = failure(run, str(error) or type(error).__name__)
        self._ended(run, record)

    def _ready(self, working: Iterable[Run]) -> Run | None:
        """The next run that can begin: a run at equal time waits for FRoG's runs on its scene."""
        busy = {run.scene for run in (*working, *self._waiting) if run.method == "frog" and not run.equal_time}
        return next((run for run in self._waiting if not (run.equal_time and run.scene in busy)), None)

    def _by(self, workers: Workers) -> None:
        answers: Answers = queue.Queue()
        working: dict[Run, Working] = {}
        stopped = False
        try:
            while self._waiting or working:
                while len(working) < workers.jobs and (run := self._ready(working)) and not self._callbacks.cancelled():
                    self._waiting.remove(run)
                    self._start(run, workers, working, answers)
                if self._callbacks.cancelled():
                    for one in working.values():
                        one.stop()
                    if not working:
                        raise Stopped
                try:
                    run, answer = answers.get(timeout=0.2)
                except queue.Empty:
                    continue
                if run not in working:
                    continue  # a share that comes after the record: they take different ways through a cluster
                if "share" in answer:
                    self._advanced(run, answer["share"])
                    continue
                working.pop(run).wait()
                if "record" in answer:
                    self._ended(run, answer["record"])
                else:
                    stopped = True
                    self._progress.shares.pop(run, None)
        finally:
            for one in working.values():
                one.stop()
            for one in working.values():
                one.wait()
        if stopped:
            raise Stopped  # also where nothing else was waiting

    def _start(self, run: Run, workers: Workers, working: dict[Run, Working], answers: Answers) -> None:
        try:
            seconds = self._seconds(run)
        except FrogError as error:
            self._ended(run, failure(run, str(error)))
            return
        working[run] = workers.start(run, self._environment, seconds, answers)
        self._advanced(run, 0.0)


def seconds_left(
    waiting: Sequence[Run], shares: dict[Run, float], records: Iterable[Record], jobs: int
) -> float | None:
    """An estimate from the mean durations of finished runs; None before the first.

    The mean is over runs of the same method and scene if there are any, else of the same method, else over all.
    """
    done = list(finished(records).values())
    if not done:
        return None

    def mean(chosen: list[Record]) -> float | None:
        return sum(record["wall_seconds"] for record in chosen) / len(chosen) if chosen else None

    def duration(run: Run) -> float:
        same_method = [record for record in done if record["method"] == run.method]
        same_scene = [record for record in same_method if record["scene"] == run.scene]
        return mean(same_scene) or mean(same_method) or mean(done) or 0.0

    left = sum(duration(run) for run in waiting)
    left += sum((1 - share) * duration(run) for run, share in shares.items())
    return left / jobs
