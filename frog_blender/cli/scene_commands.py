"""``frog export`` and ``frog import``: scenes to and from other programs' 3DGS ``.ply`` files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..engine.errors import FrogError
from .printing import say


def add_scene_parsers(commands: Any) -> None:
    """Adds both commands."""
    export = commands.add_parser("export", help="write frames of a scene as 3DGS .ply files")
    export.add_argument("scene", type=Path)
    export.add_argument("--frames", default=None, metavar="A:B", help="frames A to B - 1, counted from 0; default: all")
    export.add_argument("--out", type=Path, required=True, metavar="DIR")
    export.add_argument(
        "--y-down",
        action="store_true",
        help="turn a scene whose z points up so that its y points down, as most viewers have it; default: its own axes",
    )
    export.set_defaults(run=_export)

    imported = commands.add_parser("import", help="make a still scene of a 3DGS .ply file")
    imported.add_argument("splats", type=Path, metavar="X.ply")
    imported.add_argument("--out", type=Path, metavar="X.frog", help="default: beside the .ply")
    imported.add_argument(
        "--packed", action="store_true", help="several times smaller, changed by less than can be seen"
    )
    imported.set_defaults(run=_import)


def _export(options: argparse.Namespace) -> int:
    from ..engine.interchange.splats import export_frames
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.transform import Y_DOWN
    from .actions import parse_frames
    from .progress import bar

    scene = ScenePlayer.load(options.scene)
    frames = parse_frames(options.frames, scene.header.frame_count)
    with bar("Exporting") as report:
        turn = Y_DOWN if options.y_down else None
        stem = options.scene.stem
        paths = export_frames(scene, frames, options.out, stem, lambda done: report(done, len(frames)), turn)
    say(f"{len(paths)} files in {options.out}")
    return 0


def _import(options: argparse.Namespace) -> int:
    from ..engine.interchange.splats import free_scene_path, import_splats

    if options.splats.suffix.lower() != ".ply":
        raise FrogError(f"{options.splats}: expected a .ply file.")
    imported = import_splats(options.splats, options.out or free_scene_path(options.splats), compact=options.packed)
    say(f"{imported.gaussians:,} Gaussians in {imported.path}")
    if imported.warning:
        say(imported.warning)
    return 0
