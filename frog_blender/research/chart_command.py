"""``frog chart``: trains every method on captures, over seeds, and charts speed against accuracy."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cli.arguments import positive
from ..cli.printing import say
from ..engine import RECIPES, FrogError
from .grid import ABLATIONS
from .grid_command import add_grid_arguments, do_runs, names, say_failed, say_plan, setting

if TYPE_CHECKING:
    from .grid import Run

_ALL_ABLATIONS = ",".join(ABLATIONS)


def add_chart_parser(commands: Any) -> None:
    """Adds the command."""
    chart = commands.add_parser("chart", help="train every method on captures and chart speed against accuracy")
    chart.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    chart.add_argument("--out", type=Path, required=True, metavar="DIR", help="results, tables and charts")
    chart.add_argument(
        "--protocol", metavar="NAME", help="CAPTURE holds a published dataset: n3dv, hypernerf, technicolor or dnerf"
    )
    chart.add_argument("--methods", type=names, metavar="A,B", help="default: all of them")
    chart.add_argument(
        "--seeds", type=positive(int), default=3, metavar="N", help="number of seeds of FRoG and E-D3DGS"
    )
    chart.add_argument(
        "--other-seeds", type=positive(int), default=1, metavar="N", help="number of seeds of the other methods"
    )
    chart.add_argument("--recipe", choices=RECIPES, help="default: draft, or the protocol's")
    chart.add_argument("--steps", type=positive(int), help="default: the recipe's")
    chart.add_argument("--scale", type=positive(float), help="image size factor, such as 0.5")
    chart.add_argument("--holdout-frames", type=int, metavar="K", help="hold out every K-th frame")
    chart.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the recipe, for all methods"
    )
    chart.add_argument(
        "--row",
        action="append",
        default=[],
        metavar="LABEL=METHOD,NAME=VALUE,...",
        help="an additional row: a method with its own settings",
    )
    chart.add_argument(
        "--equal-time", action="store_true", help="also train the other methods for as long as FRoG took"
    )
    chart.add_argument("--ablation", nargs="?", const=_ALL_ABLATIONS, metavar="A,B", help=f"default: {_ALL_ABLATIONS}")
    chart.add_argument("--ablation-seeds", type=positive(int), metavar="N", help="default: --seeds")
    chart.add_argument("--timing", action="store_true", help="then time all methods, one at a time")
    chart.add_argument("--timing-steps", type=positive(int), default=300, metavar="N")
    add_grid_arguments(chart)
    chart.set_defaults(run=_chart)


def _chart(options: argparse.Namespace) -> int:
    from .report import write_report

    published = _published(options.protocol)
    failed = 0
    if not options.only_report:
        from .runs import RunEnvironment
        from .timing import WARM_UP

        if options.timing_steps <= WARM_UP:
            raise FrogError(f"--timing-steps {options.timing_steps}: expected more than the {WARM_UP} warm-up steps.")
        runs = _grid(options)
        environment = RunEnvironment(options.out, options.device)
        say_plan(runs, environment, options.jobs)
        if options.plan:
            return 0
        ended = do_runs(
            runs, environment, options.jobs, options.scheduler, options.timing_steps if options.timing else None
        )
        if ended is None:
            return 1
        failed = ended
    for path in write_report(options.out, published):
        say(path)
    return say_failed(failed)


def _published(protocol: str | None) -> str:
    """A protocol's published table; FrogError for a protocol that does not exist."""
    if not protocol:
        return ""
    from .protocols import protocol_named, published_table

    return published_table(protocol_named(protocol))


def _grid(options: argparse.Namespace) -> list[Run]:
    """The runs that the options ask for."""
    from .grid import (
        ROWS,
        CommonSettings,
        SeedCounts,
        chart_grid,
        extra_rows,
        in_order,
        named_captures,
    )

    captures, recipe = named_captures(options.captures), options.recipe or "draft"
    if options.protocol:
        captures, recipe = _protocol_captures(options)
        options.scale = options.scale or 1.0  # their captures have the paper's size
    common = CommonSettings(
        recipe,
        dict(setting(text, "--set") for text in options.set),
        options.steps,
        options.scale,
        options.holdout_frames,
        options.protocol or "",
    )
    runs = chart_grid(
        captures,
        common,
        SeedCounts(options.seeds, options.other_seeds, options.ablation_seeds),
        methods=options.methods or ROWS,
        ablation=names(options.ablation or ""),
        equal_time=options.equal_time,
    )
    rows = [_row(text) for text in options.row]
    return in_order([*runs, *extra_rows(captures, rows, common, options.other_seeds)])


def _protocol_captures(options: argparse.Namespace) -> tuple[dict[str, Path], str]:
    """The folder of each scene of a protocol, and the recipe."""
    from .protocols import captures, protocol_named

    if len(options.captures) != 1:
        raise FrogError(f"--protocol {options.protocol}: found {len(options.captures)} folders, expected one.")
    folder = options.captures[0]
    names = [name for name, _ in captures(options.protocol, folder)]
    return dict.fromkeys(names, folder), options.recipe or protocol_named(options.protocol).recipe


def _row(text: str) -> tuple[str, str, dict[str, Any]]:
    """``LABEL=METHOD,NAME=VALUE,...`` as label, method and settings."""
    label, equals, rest = text.partition("=")
    method, *settings = rest.split(",")
    if not (label and equals and method):
        raise FrogError(f"--row {text}: expected LABEL=METHOD,NAME=VALUE,... with any number of settings.")
    return label.strip(), method.strip(), dict(setting(text, "--row") for text in settings)
