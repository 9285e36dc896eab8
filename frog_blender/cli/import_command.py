"""``frog import``: a static scene from another program's 3DGS ``.ply`` file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..engine.errors import FrogError
from .printing import say


def add_import_parser(commands: Any) -> None:
    """Adds the command."""
    imported = commands.add_parser("import", help="make a static scene from a 3DGS .ply file")
    imported.add_argument("splats", type=Path, metavar="X.ply")
    imported.add_argument("--out", type=Path, metavar="X.frog", help="default: beside the .ply")
    imported.add_argument("--packed", action="store_true", help="several times smaller, without a visible difference")
    imported.set_defaults(run=_import)


def _import(options: argparse.Namespace) -> int:
    from ..engine.interchange.splats import free_scene_path, import_splats

    if options.splats.suffix.lower() != ".ply":
        raise FrogError(f"{options.splats}: expected a .ply file.")
    imported = import_splats(options.splats, options.out or free_scene_path(options.splats), compact=options.packed)
    say(f"{imported.gaussians:,} Gaussians in {imported.path}")
    if imported.warning:
        say(imported.warning)
    return 0
