"""Runs a grid: does what is not done yet, here one after the other or on a cluster, and writes each result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine import Ended, FrogError, checkpoint_path, lock_output, write_atomically
from .grid import Run
from .results import Record, append, read
from .runs import RunEnvironment, Stopped, failure, frog_seconds, not_done, perform

if TYPE_CHECKING:
    from ..engine import Cluster


@dataclass
class Progress:
    """How far a grid is; handed to the caller at every change.

    Attributes:
        total, done, failed: numbers of runs; ``done`` includes those that were done before.
        shares: of the runs in progress, the share that is done, by run.
        record: the result that was just written; None otherwise.
    """

    total: int
    done: int = 0
    failed: int = 0
    shares: dict[Run, float] = field(default_factory=dict)
    record: Record | None = None


def run_grid(
    runs: Sequence[Run],
    environment: RunEnvironment,
    *,
    cluster: Cluster | None = None,
    progressed: Callable[[Progress], None] = lambda progress: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Progress:
    """Does in order every run that is ``not_done`` yet; a run that fails is recorded, and the next one begins.

    Args:
        cluster: what does the runs, several at once; this process, one after the other, if None. Its workers see
            captures and results under the same paths.
        progressed: called with the progress at every change.
        cancelled: asked whether to stop.

    Raises:
        Stopped: if it was cancelled; the runs in progress continue next time.
    """
    # Git ignores scenes and checkpoints, which are large and can be made again, but not the results beside them.
    write_atomically(environment.folder / "scenes" / ".gitignore", b"*\n")
    if cluster is not None:
        environment = replace(environment, threads=cluster.threads(), dedicated=False)
    with lock_output(environment.results):
        grid = _Grid(runs, environment, progressed)
        grid.report()
        for equal_time in (False, True):
            if cluster is not None:
                _on_cluster(grid, grid.begin(equal_time), cluster, cancelled)
            else:
                _here(grid, grid.begin(equal_time), cancelled)
    if grid.progress.done + grid.progress.failed < grid.progress.total:
        raise Stopped
    return grid.progress


class _Grid:
    """The runs that wait, those in progress, and the results so far."""

    def __init__(
        self, runs: Sequence[Run], environment: RunEnvironment, progressed: Callable[[Progress], None]
    ) -> None:
        self.environment, self._progressed = environment, progressed
        self._records = read(environment.results)
        self.waiting = not_done(runs, self._records, environment)
        self.progress = Progress(len(runs), len(runs) - len(self.waiting))

    def report(self, record: Record | None = None) -> None:
        self.progress.record = record
        self._progressed(self.progress)

    def advanced(self, run: Run, share: float) -> None:
        self.progress.shares[run] = share
        self.report()

    def ended(self, run: Run, record: Record) -> None:
        append(self.environment.results, record)
        self._records.append(record)
        self.progress.shares.pop(run, None)
        if record["kind"] == "run":
            checkpoint_path(self.environment.scene(run)).unlink(missing_ok=True)  # which an unfinished run alone needs
            self.progress.done += 1
        else:
            self.progress.failed += 1
        self.report(record)

    def begin(self, equal_time: bool) -> Iterator[tuple[Run, float | None]]:
        """Takes the runs that wait, with their limits in seconds: those at equal time, or all others before them.

        One at equal time fails at once where FRoG did not run on its scene.
        """
        for run in [run for run in self.waiting if run.equal_time == equal_time]:
            try:
                seconds = frog_seconds(run, self._records, self.environment) if equal_time else None
            except FrogError as error:
                self.ended(run, failure(run, str(error)))
                continue
            self.advanced(run, 0.0)
            yield run, seconds


_Begun = Iterator[tuple[Run, float | None]]


def _here(grid: _Grid, begun: _Begun, cancelled: Callable[[], bool]) -> None:
    while not cancelled() and (next_run := next(begun, None)) is not None:
        run, seconds = next_run
        grid.ended(run, _done(run, grid.environment, seconds, partial(grid.advanced, run), cancelled))


def _done(
    run: Run,
    environment: RunEnvironment,
    seconds: float | None,
    advanced: Callable[[float], None],
    cancelled: Callable[[], bool],
) -> Record:
    """The record of a run, also of one that failed; Stopped if it was cancelled."""
    try:
        return perform(run, environment, seconds, advanced, cancelled)
    except (FrogError, MemoryError, ImportError) as error:
        return failure(run, str(error) or type(error).__name__)


def do_task(task: Mapping[str, Any], say: Callable[[float], None], cancelled: Callable[[], bool]) -> Record | None:
    """Does a run as a task of a cluster, and says the share that is done; None if it was cancelled."""
    try:
        return _done(task["run"], task["environment"], task["seconds"], say, cancelled)
    except Stopped:
        return None


def _on_cluster(grid: _Grid, begun: _Begun, cluster: Cluster, cancelled: Callable[[], bool]) -> None:
    environment = replace(grid.environment, folder=grid.environment.folder.resolve())
    runs: dict[str, Run] = {}

    def tasks() -> Iterator[tuple[str, Record]]:
        for run, seconds in begun:
            runs[run.key] = run
            there = replace(run, capture=str(Path(run.capture).resolve()))
            yield run.key, {"run": there, "environment": environment, "seconds": seconds}

    for key, message in cluster.messages(do_task, tasks(), cancelled):
        if not isinstance(message, Ended):
            grid.advanced(runs[key], message)
        elif message.error is not None:
            grid.ended(runs[key], failure(runs[key], message.error))
        elif message.answer is not None:
            grid.ended(runs[key], message.answer)
