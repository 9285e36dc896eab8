"""``frog chart``: trains every method on captures, over seeds, and charts speed against accuracy.

And what it shares with ``frog stability``: the grid's options, plan, progress and exit status.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cli import CANCELLED, DONE, FAILED
from ..cli.arguments import LOCAL, add_options, add_scheduler_argument, check_there, opened_cluster, positive
from ..cli.terminal import complain, printing_may_fail, say, stopping
from ..engine import RECIPES, UsageError, named, printable
from .grid import ABLATIONS, ROWS, OwnRow, Run, chart_grid, named_captures

if TYPE_CHECKING:
    from .execute import Progress

_ALL_ABLATIONS = ",".join(ABLATIONS)


def add_chart_parser(commands: Any) -> None:
    """Adds the command."""
    chart = commands.add_parser("chart", help="train every method on captures and chart speed against accuracy")
    chart.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    chart.add_argument(
        "--protocol", metavar="NAME", help="CAPTURE holds a published dataset: n3dv, hypernerf, technicolor or dnerf"
    )
    chart.add_argument("--scenes", type=names, metavar="A,B", help="of the protocol; default: those that are there")
    chart.add_argument("--methods", type=names, metavar="A,B", help="default: all of them")
    chart.add_argument("--seeds", type=positive(int), default=3, metavar="N", help="of FRoG and E-D3DGS; default: 3")
    chart.add_argument(
        "--other-seeds", type=positive(int), default=1, metavar="N", help="of the other methods; default: 1"
    )
    add_options(chart, "scale", "holdout_frames")
    chart.add_argument(
        "--row", action="append", default=[], metavar="LABEL=METHOD,NAME=VALUE,...", help="a row with its own settings"
    )
    chart.add_argument(
        "--equal-time", action="store_true", help="also train the other methods for as long as FRoG took"
    )
    chart.add_argument("--ablation", nargs="?", const=_ALL_ABLATIONS, metavar="A,B", help=f"default: {_ALL_ABLATIONS}")
    chart.add_argument("--timing", action="store_true", help="then time all methods, one at a time")
    add_grid_arguments(chart)
    chart.set_defaults(run=_chart)


def _chart(options: argparse.Namespace) -> int:
    from .charts import write_report
    from .protocols import PROTOCOLS, published_table

    published = published_table(named("protocol", options.protocol, PROTOCOLS)) if options.protocol else ""
    return run_and_report(
        options, lambda: _grid(options), lambda: write_report(options.out, published), timing=options.timing
    )


def _grid(options: argparse.Namespace) -> list[Run]:
    """The runs that the options ask for."""
    from .protocols import PROTOCOLS, captures, left_out

    check_there(options.captures)
    if options.scenes is not None and not options.protocol:
        raise UsageError("--scenes: found no --protocol, expected one, whose scenes these are.")
    common = replace(common_run(options), scale=options.scale, holdout_frames=options.holdout_frames)
    if options.protocol:
        if len(options.captures) != 1:
            raise UsageError(f"--protocol {options.protocol}: found {len(options.captures)} folders, expected one.")
        (folder,) = options.captures
        folders = {name: folder for name, _ in captures(options.protocol, folder, options.scenes or None)}
        protocol = PROTOCOLS[options.protocol]
        if lacking := left_out(options.protocol, protocol.of(folders)):
            say(lacking)
        recipe = options.recipe or protocol.recipe
        # Their captures have the paper's size.
        common = replace(common, protocol=options.protocol, recipe=recipe, scale=options.scale or 1.0)
    else:
        folders = named_captures(options.captures)
    return chart_grid(
        folders,
        common,
        seeds=(options.seeds, options.other_seeds),
        rows=[*(options.methods or ROWS), *map(_row, options.row)],
        ablation=names(options.ablation or ""),
        equal_time=options.equal_time,
    )


def _row(text: str) -> OwnRow:
    """``LABEL=METHOD,NAME=VALUE,...`` as label, method and settings."""
    label, equals, rest = text.partition("=")
    method, *settings = rest.split(",")
    if not (label and equals and method):
        raise UsageError(f"--row {text}: expected LABEL=METHOD,NAME=VALUE,... with any number of settings.")
    return label.strip(), method.strip(), dict(_setting(text, "--row") for text in settings)


def add_grid_arguments(command: argparse.ArgumentParser) -> None:
    """Adds the options that every grid has."""
    command.add_argument("--out", type=Path, required=True, metavar="DIR", help="results, tables and images")
    command.add_argument("--recipe", choices=RECIPES, help="default: draft, or the protocol's")
    add_options(command, "steps", "device")
    command.set_defaults(scale=None, holdout_frames=None, steps=None, device="auto")
    command.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the recipe, for all methods"
    )
    add_scheduler_argument(command, "number of parallel runs, which share the cores")
    instead = command.add_mutually_exclusive_group()
    instead.add_argument("--plan", action="store_true", help="list the runs and stop")
    instead.add_argument("--only-report", action="store_true", help="write the report of the finished runs and stop")


def names(text: str) -> list[str]:
    """The parts of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def _setting(text: str, option: str) -> tuple[str, Any]:
    """``NAME=VALUE`` as both; the value as JSON if it is valid JSON, else as text. UsageError for other text."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise UsageError(f"{option} {text}: expected NAME=VALUE, such as network_rate=1e-3.")
    try:
        parsed = json.loads(value)
    except ValueError:
        parsed = value
    return name.strip(), tuple(parsed) if isinstance(parsed, list) else parsed


def common_run(options: argparse.Namespace) -> Run:
    """What all runs of a grid share."""
    overrides = dict(_setting(text, "--set") for text in options.set)
    return Run(recipe=options.recipe or "draft", overrides=tuple(overrides.items()), steps=options.steps)


def run_and_report(
    options: argparse.Namespace, grid: Callable[[], list[Run]], report: Callable[[], list[Path]], timing: bool = False
) -> int:
    """Does a grid's runs, unless told otherwise, and writes its report; returns the exit status.

    Args:
        timing: also run the timing pass.
    """
    failed = 0
    if not options.only_report:
        runs = grid()
        _say_plan(runs, options)
        if options.plan:
            return 0
        ended = _do_runs(runs, options, timing)
        if ended is None:
            return CANCELLED
        failed = ended
    for path in report():
        say(path)
    if failed:
        complain(f"{failed} {'run' if failed == 1 else 'runs'} failed; the tables say why.")
    return FAILED if failed else DONE


def _say_plan(runs: Sequence[Run], options: argparse.Namespace) -> None:
    """Prints what the grid will run."""
    from .results import read
    from .runs import RunEnvironment, not_done

    environment = RunEnvironment(options.out)
    waiting = not_done(runs, read(environment.results), environment)
    rows = Counter((run.condition or run.scene, run.label, run.equal_time) for run in runs)
    for (scene, label, equal_time), count in rows.items():
        how = "at FRoG's time" if equal_time else "at equal steps"
        say(f"{scene}: {label}, {how}, {count} {'seed' if count == 1 else 'seeds'}")
    print(f"{len(runs)} runs, {len(waiting)} to do", flush=True)


def _do_runs(runs: Sequence[Run], options: argparse.Namespace, timing: bool) -> int | None:
    """Runs the grid; returns the number of failed runs, or None if it was stopped."""
    import matplotlib  # noqa: F401 - which the report needs: said now, not after hours
    import numpy

    from ..cli.progress import bar
    from ..engine import perceptual_metrics
    from .execute import run_grid
    from .runs import RunEnvironment, Stopped
    from .timing import time_grid

    numpy.finfo(numpy.float64)  # cached here: training flushes denormals, with which this lookup warns
    for metric, reason in perceptual_metrics()[1].items():
        say(f"{metric} will be missing: {reason}.")
    environment = RunEnvironment(options.out, options.device)
    scheduler = options.scheduler or (LOCAL if options.jobs > 1 else None)
    with printing_may_fail(), stopping() as cancelled:
        with suppress(Stopped):
            workers = opened_cluster(scheduler, options.jobs) if scheduler else nullcontext()
            with workers as cluster, _shown(len(runs)) as show:
                failed = run_grid(runs, environment, cluster=cluster, progressed=show, cancelled=cancelled).failed
            if timing:
                with bar("Timing") as report:
                    records = time_grid(runs, environment, report, cancelled)
                failed += sum(record["kind"] == "failed" for record in records)
            if not cancelled():
                return failed
        complain("stopped; run the same command again to continue.")
    return None


@contextmanager
def _shown(total: int) -> Iterator[Callable[[Progress], None]]:
    """Yields a callback for the grid's progress: it shows one bar over all runs, and a line for each finished run."""
    from tqdm import tqdm

    from ..cli.progress import Line

    layout = "{desc} |{bar}| {n:.2f}/{total} runs, {remaining} left{postfix}"
    with Line(desc="Grid", total=total, bar_format=layout) as line:

        def show(progress: Progress) -> None:
            line.n = progress.done + progress.failed + sum(progress.shares.values())
            working = [f"{run.condition or run.scene} {run.label} {run.seed}" for run in progress.shares]
            line.set_postfix_str(", ".join(working), refresh=progress.record is None)
            if progress.record is not None:
                tqdm.write(printable(_sentence(progress.record)), file=sys.stderr)

        yield show


def _sentence(record: dict[str, Any]) -> str:
    name = f"{record['condition'] or record['scene']}, {record['label']}, seed {record['seed']}"
    if record["kind"] == "failed":
        return f"{name}: failed: {record['error']}"
    return f"{name}: {record['psnr']:.2f} dB, {record['gaussians']} Gaussians, {record['train_seconds']:.0f} s"
