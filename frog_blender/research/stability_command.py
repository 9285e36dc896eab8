"""``frog stability``: methods under conditions in which methods fail, over seeds, as a heat map."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..cli.arguments import positive
from ..cli.printing import say
from ..engine import RECIPES
from .corruptions.catalogue import BASES, CLEAN, CONDITIONS
from .grid_command import add_grid_arguments, do_runs, names, say_failed, say_plan, setting

_GIVEN = [base for base in BASES if base != CLEAN]  # each has an option of its own


def add_stability_parser(commands: Any) -> None:
    """Adds the command."""
    parser = commands.add_parser("stability", help="train methods under hard conditions and draw a heat map")
    parser.add_argument(
        "capture", type=Path, metavar="CAPTURE", help="several static cameras, the capture that conditions change"
    )
    for base in _GIVEN:
        parser.add_argument(f"--{base}", type=Path, metavar="DIR", help=BASES[base])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="results, table and heat map")
    parser.add_argument("--conditions", type=names, metavar="A,B", help="default: all of them")
    parser.add_argument("--methods", type=names, metavar="A,B", help="default: frog,frog-auto,ed3dgs,static,hexplane")
    parser.add_argument("--frog-seeds", type=positive(int), default=5, metavar="N", help="number of FRoG's seeds")
    parser.add_argument(
        "--seeds", type=positive(int), default=3, metavar="N", help="number of every other method's seeds"
    )
    parser.add_argument("--recipe", choices=RECIPES, default="draft")
    parser.add_argument("--steps", type=positive(int), help="default: the recipe's")
    parser.add_argument(
        "--side", type=positive(int), metavar="PIXELS", help="reduce larger images to this longest side"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the recipe, for all methods"
    )
    add_grid_arguments(parser)
    parser.set_defaults(run=_stability)


def _stability(options: argparse.Namespace) -> int:
    from .heat_map import write_stability

    failed = 0
    if not options.only_report:
        from .grid import CommonSettings
        from .runs import RunEnvironment
        from .stability import ROWS, stability_grid, without_captures

        given = {CLEAN: options.capture, **{base: getattr(options, base) for base in _GIVEN}}
        captures = {base: folder for base, folder in given.items() if folder is not None}
        wanted = options.conditions or list(CONDITIONS)
        overrides = dict(setting(text, "--set") for text in options.set)
        runs = stability_grid(
            captures,
            CommonSettings(options.recipe, overrides, options.steps),
            conditions=wanted,
            methods=options.methods or ROWS,
            frog_seeds=options.frog_seeds,
            seeds=options.seeds,
            side=options.side,
        )
        environment = RunEnvironment(options.out, options.device)
        for sentence in without_captures(captures, wanted):
            say(sentence)
        say_plan(runs, environment, options.jobs)
        if options.plan:
            return 0
        ended = do_runs(runs, environment, options.jobs, options.scheduler)
        if ended is None:
            return 1
        failed = ended
    for path in write_stability(options.out):
        say(path)
    return say_failed(failed)
