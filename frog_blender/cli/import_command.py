"""``frog import``: a scene from another program's Gaussians."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..engine.errors import FrogError
from .arguments import positive
from .printing import say


def add_import_parser(commands: Any) -> None:
    """Adds the command."""
    imported = commands.add_parser(
        "import",
        help="make a scene of other programs' Gaussians",
    )
    imported.add_argument("splats", type=Path, metavar="FILE", help="or a folder or .zip of .ply frames")
    imported.add_argument("--out", type=Path, metavar="X.frog", help="default: beside the file")
    imported.add_argument("--fps", type=positive(float), help="of .ply frames; default: 30")
    imported.add_argument("--packed", action="store_true", help="several times smaller, without a visible difference")
    imported.set_defaults(run=_import)


def _import(options: argparse.Namespace) -> int:
    from ..engine.interchange.imports import RATE, free_scene_path, import_scene, is_sequence
    from .progress import bar

    if options.fps and options.splats.is_file() and not is_sequence(options.splats):
        raise FrogError("--fps: found a file with frames at times of its own or a single one, expected .ply frames.")
    target = options.out or free_scene_path(options.splats)
    with bar("Importing") as report:
        imported = import_scene(
            options.splats, target, compact=options.packed, rate=options.fps or RATE, progress=report
        )
    frames = f", {imported.frames:,} frames" if imported.frames > 1 else ""
    say(f"{imported.gaussians:,} Gaussians{frames} in {imported.path}")
    if imported.warning:
        say(imported.warning)
    return 0
