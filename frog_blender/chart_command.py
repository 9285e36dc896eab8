"""``frog chart``: trains every method on captures, over seeds, and draws speed against accuracy."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .engine.comparison.grid import ABLATIONS
from .engine.errors import FrogError

if TYPE_CHECKING:
    from .engine.comparison.execute import Progress
    from .engine.comparison.grid import Run
    from .engine.comparison.runs import Conditions

_ALL_ABLATIONS = ",".join(ABLATIONS)


def add_chart_parser(commands: Any, positive: Callable[[type], Any], recipes: Sequence[str]) -> None:
    """Adds the command to the parser's ``commands``.

    Args:
        positive: makes an argument type of ``int`` or ``float`` that takes positive numbers only.
        recipes: their names.
    """
    chart = commands.add_parser("chart", help="train every method on captures and chart speed against accuracy")
    chart.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    chart.add_argument("--out", type=Path, required=True, metavar="DIR", help="results, tables and charts")
    chart.add_argument(
        "--protocol", metavar="NAME", help="CAPTURE holds a paper's data set: n3dv, hypernerf, technicolor"
    )
    chart.add_argument("--methods", type=_names, metavar="A,B", help="default: all of them")
    chart.add_argument("--seeds", type=positive(int), default=3, metavar="N", help="of FRoG and E-D3DGS")
    chart.add_argument("--other-seeds", type=positive(int), default=1, metavar="N", help="of the other methods")
    chart.add_argument("--recipe", choices=recipes, help="default: draft, or the protocol's")
    chart.add_argument("--steps", type=positive(int), help="default: the recipe's")
    chart.add_argument("--scale", type=positive(float), help="picture size factor, such as 0.5")
    chart.add_argument("--holdout-frames", type=int, metavar="K", help="withhold every K-th moment")
    chart.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the recipe, for all"
    )
    chart.add_argument(
        "--row",
        action="append",
        default=[],
        metavar="LABEL=METHOD,NAME=VALUE,...",
        help="one more row: a method with settings of its own",
    )
    chart.add_argument("--equal-time", action="store_true", help="the others again, for as long as FRoG took")
    chart.add_argument("--ablation", nargs="?", const=_ALL_ABLATIONS, metavar="A,B", help=f"default: {_ALL_ABLATIONS}")
    chart.add_argument("--ablation-seeds", type=positive(int), metavar="N", help="default: --seeds")
    chart.add_argument("--timing", action="store_true", help="then time all methods, one after the other")
    chart.add_argument("--timing-steps", type=positive(int), default=300, metavar="N")
    chart.add_argument("--jobs", type=positive(int), default=1, metavar="N", help="runs at once, sharing the cores")
    chart.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    chart.add_argument("--plan", action="store_true", help="say what would run, and stop")
    chart.add_argument("--only-report", action="store_true", help="draw what has been done so far")
    chart.set_defaults(run=_chart)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _chart(options: argparse.Namespace) -> int:
    from .engine.comparison.report import write_report

    published = _published(options.protocol)
    failed = 0
    if not options.only_report:
        from .engine.comparison.runs import Conditions

        runs = _grid(options)
        conditions = Conditions(options.out, options.device)
        _say_plan(runs, conditions, options.jobs)
        if options.plan:
            return 0
        finished, failed = _work(options, runs, conditions)
        if not finished:
            print("frog: stopped; the same command goes on from here.", file=sys.stderr)
            return 1
    for path in write_report(options.out, published):
        print(path)
    if failed:
        print(f"frog: {failed} runs failed; the tables say why.", file=sys.stderr)
    return 1 if failed else 0


def _published(protocol: str | None) -> str:
    """A protocol's published table; FrogError for a protocol that does not exist."""
    if not protocol:
        return ""
    from .engine.comparison.protocols import protocol_named, published_table

    return published_table(protocol_named(protocol))


def _grid(options: argparse.Namespace) -> list[Run]:
    """The runs that the options ask for."""
    from .engine.comparison.grid import AUTO_ROW, ROWS, chart_grid, extra_rows, in_order, named_captures
    from .engine.training.methods import METHODS as KNOWN

    captures, recipe = named_captures(options.captures), options.recipe or "draft"
    if options.protocol:
        captures, recipe = _protocol_captures(options)
        options.scale = options.scale or 1.0  # their captures have the paper's size
    common = dict(_setting(text, "--set") for text in options.set)
    shared = {
        "recipe": recipe,
        "overrides": common,
        "seeds": options.seeds,
        "steps": options.steps,
        "scale": options.scale,
        "holdout_frames": options.holdout_frames,
        "protocol": options.protocol or "",
    }
    runs = chart_grid(
        captures,
        methods=options.methods or [name for name in ROWS if name in KNOWN or name == AUTO_ROW],
        other_seeds=options.other_seeds,
        ablation=_names(options.ablation or ""),
        ablation_seeds=options.ablation_seeds,
        equal_time=options.equal_time,
        **shared,
    )
    rows = [_row(text) for text in options.row]
    return in_order([*runs, *extra_rows(captures, rows, **{**shared, "seeds": options.other_seeds})])


def _protocol_captures(options: argparse.Namespace) -> tuple[dict[str, Path], str]:
    """A folder for each scene of a protocol, and the recipe."""
    from .engine.comparison.protocols import captures, protocol_named

    if len(options.captures) != 1:
        raise FrogError(f"--protocol {options.protocol}: found {len(options.captures)} folders, expected one.")
    folder = options.captures[0]
    names = [name for name, _ in captures(options.protocol, folder)]
    return dict.fromkeys(names, folder), options.recipe or protocol_named(options.protocol).recipe


def _setting(text: str, option: str) -> tuple[str, Any]:
    """``NAME=VALUE``; the value as JSON where it is any, else as text."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise FrogError(f"{option} {text}: expected NAME=VALUE, such as network_rate=1e-3.")
    try:
        parsed = json.loads(value)
    except ValueError:
        parsed = value
    return name.strip(), tuple(parsed) if isinstance(parsed, list) else parsed


def _row(text: str) -> tuple[str, str, dict[str, Any]]:
    """``LABEL=METHOD,NAME=VALUE,...`` as label, method and settings."""
    label, equals, rest = text.partition("=")
    method, *settings = rest.split(",")
    if not (label and equals and method):
        raise FrogError(f"--row {text}: expected LABEL=METHOD,NAME=VALUE,... with as many settings as you like.")
    return label.strip(), method.strip(), dict(_setting(setting, "--row") for setting in settings)


def _say_plan(runs: Sequence[Run], conditions: Conditions, jobs: int) -> None:
    """What the grid is, before it runs."""
    from collections import Counter

    from .engine.comparison.execute import seconds_left
    from .engine.comparison.results import read
    from .engine.comparison.runs import is_done
    from .engine.comparison.tables import duration

    records = read(conditions.results)
    waiting = [run for run in runs if not is_done(run, records)]
    for (scene, label, equal_time), count in Counter((run.scene, run.label, run.equal_time) for run in runs).items():
        how = "at FRoG's time" if equal_time else "at equal steps"
        print(f"{scene}: {label}, {how}, {count} {'seed' if count == 1 else 'seeds'}")
    left = seconds_left(waiting, {}, records, jobs)
    estimate = f", about {duration(left)}" if left is not None and waiting else ""
    print(f"{len(runs)} runs, {len(waiting)} to do{estimate}", flush=True)


def _work(options: argparse.Namespace, runs: Sequence[Run], conditions: Conditions) -> tuple[bool, int]:
    """Does the grid and the timings; whether it came to its end, and how many runs failed."""
    import numpy

    from .engine.comparison.execute import run_grid
    from .engine.comparison.runs import Stopped
    from .engine.comparison.timing_pass import time_grid
    from .progress import bar

    numpy.finfo(numpy.float64)  # looked up once; later, with denormals flushed by training, it would warn
    with _stopping() as cancelled:
        try:
            with _shown(len(runs)) as told:
                progress = run_grid(runs, conditions, jobs=options.jobs, told=told, cancelled=cancelled)
        except Stopped:
            return False, 0
        failed = progress.failed
        if options.timing:
            with bar("Timing") as report:
                records = time_grid(runs, conditions, options.timing_steps, report, cancelled)
            failed += sum(record["kind"] == "failed" for record in records)
        return not cancelled(), failed


@contextmanager
def _stopping() -> Iterator[Callable[[], bool]]:
    """Yields a question that Ctrl-C answers with yes; a second Ctrl-C leaves at once."""
    asked = False

    def stop(*_: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    previous = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, previous)


@contextmanager
def _shown(total: int) -> Iterator[Callable[[Progress], None]]:
    """Yields what takes the grid's progress: one bar over all runs, and a line for each that ended."""
    from tqdm import tqdm

    from .engine.comparison.tables import duration

    layout = "{desc} |{bar}| {n:.2f}/{total} runs{postfix}"
    with tqdm(desc="Grid", total=total, file=sys.stderr, bar_format=layout) as line:

        def show(progress: Progress) -> None:
            line.n = progress.done + progress.failed + sum(progress.shares.values())
            names = [f"{run.scene} {run.label} {run.seed}" for run in progress.shares]
            left = "" if progress.seconds_left is None else f"about {duration(progress.seconds_left)} left"
            line.set_postfix_str(" ".join([", ".join(names), left]).strip(), refresh=progress.record is None)
            if progress.record is not None:
                tqdm.write(_sentence(progress), file=sys.stderr)

        yield show


def _sentence(progress: Progress) -> str:
    record = progress.record or {}
    name = f"{record['scene']}, {record['label']}, seed {record['seed']}"
    if record["kind"] == "failed":
        return f"{name}: failed: {record['error']}"
    return f"{name}: {record['psnr']:.2f} dB, {record['gaussians']} Gaussians, {record['train_seconds']:.0f} s"
