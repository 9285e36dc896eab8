"""``frog demo``: the whole workflow on a demo capture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..engine.recipes import RECIPES
from .arguments import positive


def add_demo_parser(commands: Any) -> None:
    """Adds the command."""
    demo = commands.add_parser("demo", help="train, play and render a demo capture inside Blender's module")
    demo.add_argument("--capture", choices=["room", "dim", "fast", "walk"], default="room")
    demo.add_argument("--out", type=Path, default=Path("out"))
    demo.add_argument("--recipe", choices=RECIPES, default="standard")
    demo.add_argument("--seconds", type=positive(float), help="of training; default: 300, and 900 for walk")
    demo.set_defaults(run=_demo)


def _demo(options: argparse.Namespace) -> int:
    from .demo import check_packages, run_demo
    from .demo_captures import demo_capture

    check_packages()
    run_demo(demo_capture(options.capture), options.out, options.recipe, options.seconds)
    return 0
