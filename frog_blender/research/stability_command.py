"""``frog stability``: methods under conditions in which methods fail, over seeds, as a heat map."""

import argparse
from pathlib import Path
from typing import Any

from ..cli.arguments import check_there, positive
from ..cli.terminal import say
from .chart_command import add_grid_arguments, common_run, names, run_and_report
from .conditions import BASES, CLEAN, CONDITIONS
from .grid import Run

_GIVEN = [base for base in BASES if base != CLEAN]  # each has an option of its own


def add_stability_parser(commands: Any) -> None:
    """Adds the command."""
    parser = commands.add_parser("stability", help="train methods under hard conditions and draw a heat map")
    parser.add_argument(
        "capture", type=Path, metavar="CAPTURE", help="several static cameras, the capture that conditions change"
    )
    for base in _GIVEN:
        parser.add_argument(f"--{base}", type=Path, metavar="DIR", help=BASES[base])
    parser.add_argument("--conditions", type=names, metavar="A,B", help="default: all of them")
    parser.add_argument("--methods", type=names, metavar="A,B", help="default: frog,frog-auto,ed3dgs,static,hexplane")
    parser.add_argument("--frog-seeds", type=positive(int), default=5, metavar="N", help="of FRoG; default: 5")
    parser.add_argument("--seeds", type=positive(int), default=3, metavar="N", help="of the others; default: 3")
    parser.add_argument(
        "--side", type=positive(int), metavar="PIXELS", help="reduce larger images to this longest side"
    )
    add_grid_arguments(parser)
    parser.set_defaults(run=_stability)


def _stability(options: argparse.Namespace) -> int:
    from .stability import ROWS, stability_grid, without_captures, write_stability

    def grid() -> list[Run]:
        given = {CLEAN: options.capture, **{base: getattr(options, base) for base in _GIVEN}}
        captures = {base: folder for base, folder in given.items() if folder is not None}
        check_there(captures.values())
        conditions = options.conditions or list(CONDITIONS)
        runs = stability_grid(
            captures,
            common_run(options),
            conditions=conditions,
            rows=options.methods or ROWS,
            seeds=(options.frog_seeds, options.seeds),
            side=options.side,
        )
        for sentence in without_captures(captures, conditions):
            say(sentence)
        return runs

    return run_and_report(options, grid, lambda: write_stability(options.out))
