"""``frog export``: a scene for other programs, as one file that plays or as a file for each frame."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from .arguments import add_edits_argument, add_frames_argument, edited_scene, frames_of
from .printing import say

if TYPE_CHECKING:
    from ..engine.interchange.take import SceneTake, Sound
    from ..engine.playback.render_files import PlayedFrames


def add_export_parser(commands: Any) -> None:
    """Adds the command."""
    export = commands.add_parser("export", help="write a scene for other programs")
    export.add_argument("scene", type=Path)
    add_frames_argument(export)
    export.add_argument(
        "--out", type=Path, required=True, metavar="PATH", help="folder of a file for each frame, or file"
    )
    kinds = export.add_mutually_exclusive_group()
    kinds.add_argument(
        "--usd", action="store_true", help="one .usdc, .usda or .usd file that plays, with cameras and the sound's path"
    )
    kinds.add_argument("--html", action="store_true", help="one .html file that plays in a browser, with sound")
    kinds.add_argument("--spz", action="store_true", help="a compressed .spz file for each frame")
    kinds.add_argument("--glb", action="store_true", help="a glTF file for each frame, with KHR_gaussian_splatting")
    export.add_argument(
        "--float", action="store_true", help="--usd in single precision; default: half, but for positions"
    )
    export.add_argument(
        "--spz-version", type=int, choices=(3, 4), help="of --spz: 4 is smaller, and fewer programs read it; default: 3"
    )
    export.add_argument("--silent", action="store_true", help="without sound")
    export.add_argument(
        "--y-down",
        action="store_true",
        help="rotate .ply files of a scene whose z axis points up so that its y axis points down, as most viewers "
        "expect; default: the scene's own axes",
    )
    add_edits_argument(export)
    export.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    from ..engine.editing.edited_scene import RetimedScene
    from ..engine.interchange.take import SceneTake
    from ..engine.playback.player import ScenePlayer

    _check_format(options)
    scene, timing = edited_scene(ScenePlayer.load(options.scene), options.edits)
    frames = frames_of(options.frames, scene.header.frame_count if timing is None else len(timing.frames))
    if _plays(options):
        _export_take(options, SceneTake(scene, options.scene.stem, frames, timing=timing))
    else:
        _export_frames(options, scene if timing is None else RetimedScene(scene, timing), frames)
    return 0


def _plays(options: argparse.Namespace) -> bool:
    """Whether one file holds all frames."""
    return bool(options.usd or options.html)


def _check_format(options: argparse.Namespace) -> None:
    """FrogError for an argument that the format knows nothing of."""
    if options.y_down and (_plays(options) or options.spz or options.glb):
        raise FrogError("--y-down: found a format that says itself which way is up, expected .ply files.")
    if options.float and not options.usd:
        raise FrogError("--float: found a format with a precision of its own, expected --usd.")
    if options.spz_version and not options.spz:
        raise FrogError("--spz-version: found another format, expected --spz.")
    if options.silent and not _plays(options):
        raise FrogError("--silent: found a format without sound, expected --usd or --html.")


def _export_take(options: argparse.Namespace, take: SceneTake) -> None:
    from ..engine.interchange.usd_export import write_usd
    from ..engine.interchange.web_page.page import write_page
    from .progress import bar

    if not options.silent:
        take = replace(take, sound=_sound(options.scene, take))
    frames = take.chosen
    with bar("Exporting") as report:
        if options.html:
            steps = write_page(options.out, take)
        else:
            steps = write_usd(options.out, take, full_precision=options.float)
        for done in steps:
            report(done, len(frames))
    size = options.out.stat().st_size / 1e6
    say(f"{len(frames)} frames in {options.out}, {size:,.1f} MB{', with sound' if take.sound else ''}")


def _sound(scene_file: Path, take: SceneTake) -> Sound | None:
    """What is heard with a take of a scene's file; None for silence."""
    from ..engine.interchange.take import sound_of

    shown = [float(frame) if take.timing is None else take.timing.frames[frame] for frame in take.chosen]
    return sound_of(take.header, scene_file, shown, take.rate)


def _export_frames(options: argparse.Namespace, scene: PlayedFrames, frames: range) -> None:
    from ..engine.interchange.frame_files import export_frames
    from ..engine.interchange.spz import VERSIONS
    from ..engine.playback.transform import Y_DOWN
    from .progress import bar

    suffix = ".spz" if options.spz else ".glb" if options.glb else ".ply"
    path = options.out / f"{options.scene.stem}{suffix}"
    turn, version = Y_DOWN if options.y_down else None, options.spz_version or VERSIONS[0]
    with bar("Exporting") as report:
        for done, _ in enumerate(export_frames(scene, frames, path, turn=turn, spz_version=version), 1):
            report(done, len(frames))
    say(f"{len(frames)} files in {options.out}")
