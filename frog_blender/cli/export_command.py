"""``frog export``: frames of a scene as 3DGS ``.ply`` files for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .arguments import add_edits_argument, add_frames_argument, edited_scene, frames_of
from .printing import say


def add_export_parser(commands: Any) -> None:
    """Adds the command."""
    export = commands.add_parser("export", help="write frames of a scene as 3DGS .ply files")
    export.add_argument("scene", type=Path)
    add_frames_argument(export)
    export.add_argument("--out", type=Path, required=True, metavar="DIR")
    export.add_argument(
        "--y-down",
        action="store_true",
        help="rotate a scene whose z axis points up so that its y axis points down, as most viewers expect; "
        "default: the scene's own axes",
    )
    add_edits_argument(export)
    export.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    from ..engine.interchange.splats import export_frames
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.transform import Y_DOWN
    from .progress import bar

    scene = edited_scene(ScenePlayer.load(options.scene), options.edits)
    frames = frames_of(options.frames, scene.header.frame_count)
    turn = Y_DOWN if options.y_down else None
    with bar("Exporting") as report:
        paths = export_frames(
            scene, frames, options.out, options.scene.stem, lambda done: report(done, len(frames)), turn
        )
    say(f"{len(paths)} files in {options.out}")
    return 0
