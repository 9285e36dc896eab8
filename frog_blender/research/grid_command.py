"""What the commands that train a grid of runs share: the plan, the progress bar, the exit status."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..cli.arguments import positive
from ..cli.cluster import add_scheduler_argument, opened_cluster
from ..cli.printing import complain, say
from ..cli.stopping import stopping
from ..cli.streams import printing_may_fail
from ..engine import FrogError, printable

if TYPE_CHECKING:
    from .execute import Progress
    from .grid import Run
    from .runs import RunEnvironment
    from .workers import Workers


def add_grid_arguments(command: argparse.ArgumentParser) -> None:
    """Adds the options that decide how a grid is run, not what it holds."""
    command.add_argument(
        "--jobs", type=positive(int), default=1, metavar="N", help="number of parallel runs, which share the cores"
    )
    add_scheduler_argument(command)
    command.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    command.add_argument("--plan", action="store_true", help="list the runs and stop")
    command.add_argument("--only-report", action="store_true", help="write the report of the finished runs and stop")


def names(text: str) -> list[str]:
    """The parts of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def setting(text: str, option: str) -> tuple[str, Any]:
    """``NAME=VALUE`` as both; the value as JSON if it is valid JSON, else as text. FrogError for other text."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise FrogError(f"{option} {text}: expected NAME=VALUE, such as network_rate=1e-3.")
    try:
        parsed = json.loads(value)
    except ValueError:
        parsed = value
    return name.strip(), tuple(parsed) if isinstance(parsed, list) else parsed


def say_plan(runs: Sequence[Run], environment: RunEnvironment, jobs: int) -> None:
    """Prints what the grid will run."""
    from collections import Counter

    from .execute import seconds_left
    from .results import read
    from .runs import is_done
    from .tables import duration

    records = read(environment.results)
    waiting = [run for run in runs if not is_done(run, records)]
    rows = Counter((run.condition or run.scene, run.label, run.equal_time) for run in runs)
    for (scene, label, equal_time), count in rows.items():
        how = "at FRoG's time" if equal_time else "at equal steps"
        say(f"{scene}: {label}, {how}, {count} {'seed' if count == 1 else 'seeds'}")
    left = seconds_left(waiting, {}, records, jobs)
    estimate = f", about {duration(left)}" if left is not None and waiting else ""
    print(f"{len(runs)} runs, {len(waiting)} to do{estimate}", flush=True)


def do_runs(
    runs: Sequence[Run],
    environment: RunEnvironment,
    jobs: int,
    scheduler: str | None = None,
    timing_steps: int | None = None,
) -> int | None:
    """Runs the grid; returns the number of failed runs, or None if it was stopped.

    Args:
        scheduler: the address of a Dask scheduler whose workers do the runs, or "local".
        timing_steps: also run the timing pass, with this many training steps.
    """
    import numpy

    from ..cli.progress import bar
    from .execute import GridCallbacks, run_grid
    from .runs import Stopped
    from .timing_pass import time_grid

    numpy.finfo(numpy.float64)  # cached here: training flushes denormals, with which this lookup warns
    with printing_may_fail(), stopping() as cancelled:
        failed, stopped = 0, False
        try:
            with _workers(jobs, scheduler) as workers, _shown(len(runs)) as show:
                failed = run_grid(runs, environment, workers=workers, callbacks=GridCallbacks(show, cancelled)).failed
        except Stopped:
            stopped = True
        if timing_steps and not stopped:
            with bar("Timing") as report:
                records = time_grid(runs, environment, timing_steps, report, cancelled)
            failed += sum(record["kind"] == "failed" for record in records)
        if stopped or cancelled():
            print("frog: stopped; run the same command again to continue.", file=sys.stderr)
            return None
    return failed


@contextmanager
def _workers(jobs: int, scheduler: str | None) -> Iterator[Workers | None]:
    """Yields who does the runs; None for this process."""
    from .workers import ClusterWorkers, Processes

    if scheduler is None:
        yield Processes(jobs) if jobs > 1 else None
        return
    with opened_cluster(scheduler, jobs) as cluster:
        yield ClusterWorkers(cluster, cluster.threads())


def say_failed(failed: int) -> int:
    """Reports failed runs; returns the exit status."""
    if failed:
        complain(f"{failed} {'run' if failed == 1 else 'runs'} failed; the tables say why.")
    return 1 if failed else 0


@contextmanager
def _shown(total: int) -> Iterator[Callable[[Progress], None]]:
    """Yields a callback for the grid's progress: it shows one bar over all runs, and a line for each finished run."""
    from tqdm import tqdm

    from .tables import duration

    layout = "{desc} |{bar}| {n:.2f}/{total} runs{postfix}"
    with tqdm(desc="Grid", total=total, file=sys.stderr, bar_format=layout) as line:

        def show(progress: Progress) -> None:
            line.n = progress.done + progress.failed + sum(progress.shares.values())
            working = [f"{run.condition or run.scene} {run.label} {run.seed}" for run in progress.shares]
            left = "" if progress.seconds_left is None else f"about {duration(progress.seconds_left)} left"
            line.set_postfix_str(" ".join([", ".join(working), left]).strip(), refresh=progress.record is None)
            if progress.record is not None:
                tqdm.write(printable(_sentence(progress)), file=sys.stderr)

        yield show


def _sentence(progress: Progress) -> str:
    record = progress.record or {}
    name = f"{record.get('condition') or record['scene']}, {record['label']}, seed {record['seed']}"
    if record["kind"] == "failed":
        return f"{name}: failed: {record['error']}"
    return f"{name}: {record['psnr']:.2f} dB, {record['gaussians']} Gaussians, {record['train_seconds']:.0f} s"
