"""``frog render``, ``frog export`` and ``frog import``: frames of a scene as images, and other programs' formats."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.capture.camera import Camera
from ..engine.errors import FrogError, UsageError, found_instead
from .arguments import (
    Reads,
    add_scene_arguments,
    add_scheduler_argument,
    edited_scene,
    frames_of,
    opened_cluster,
    positive,
)
from .terminal import add_json_argument, say

if TYPE_CHECKING:
    from ..engine.editing.edits import Timing
    from ..engine.interchange.take import Take
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.render_files import PlayedFrames
    from ..engine.playback.views import View


_PARTS_A_SLOT = 4  # parts of a render for each task that runs at once: the last one is not waited for long


def add_render_parser(commands: Any) -> None:
    """Adds the command."""
    render = commands.add_parser("render", help="render frames of a scene as cameras see them")
    add_scene_arguments(render)
    seen = render.add_mutually_exclusive_group(required=True)
    seen.add_argument("--camera", metavar="NAME", help="one of the scene's, or moving")
    of_files = "transforms.json, or a COLMAP model's folder; --frames means its numbers, where it has any"
    seen.add_argument("--cameras", type=Path, action=Reads, metavar="FILE", help=of_files)
    render.add_argument(
        "--step", type=positive(float, 1e-3), metavar="FRAMES", help="between images, such as 0.5; default: 1"
    )
    times = "instead of --frames: from 0, the first one, to 1, the last one"
    render.add_argument("--times", type=_share, nargs="+", metavar="T", help=times)
    render.add_argument("--size", type=_size, metavar="WxH", help="or 50%% of the cameras'")
    render.add_argument("--canonical", action="store_true", help="the canonical field, which nothing has moved")
    images = "a folder for PNG files, or names such as shot_####.exr, .png or .jpg"
    render.add_argument("-o", "--out", type=Path, required=True, metavar="OUT", help=images)
    alphas = ["none", "straight", "premultiplied"]
    render.add_argument("--alpha", choices=alphas, default="none", help="in place of a background; default: none")
    color = "sRGB, from 0 to 1; default: the training's"
    render.add_argument("--background", type=_share, nargs=3, metavar=("R", "G", "B"), help=color)
    render.add_argument("--float", action="store_true", help="colours of .exr in single precision; default: half")
    render.add_argument("--vectors", action="store_true", help="motion vectors in .exr")
    render.add_argument(
        "--device", choices=["cpu", "cuda", "auto"], default="cpu", help="cuda and auto need torch; default: cpu"
    )
    add_scheduler_argument(render, "processes of --scheduler local, which share the cores")
    add_json_argument(render)
    render.set_defaults(run=_render)


def _share(text: str) -> float:
    with suppress(ValueError):
        if 0 <= float(text) <= 1:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")


def _size(text: str) -> tuple[int, int] | float:
    if text.endswith("%"):
        return positive(float)(text[:-1]) / 100
    sides = [int(positive(int)(side)) for side in text.lower().split("x")]
    if len(sides) != 2:
        raise argparse.ArgumentTypeError(f"{text} is neither WIDTHxHEIGHT nor a percentage")
    return sides[0], sides[1]


def _render(options: argparse.Namespace) -> int:
    from .progress import bar

    render, files, told = _opened(vars(options))
    with bar("Rendering") as report:
        if options.scheduler is None:
            for done, _ in enumerate(render(range(len(files))), 1):
                report(done, len(files))
        else:
            _on_cluster(options, len(files), report)
    options.figures = told()
    say(f"{len(files)} images in {files[0].parent}")
    return 0


def _written(files: Sequence[Path], shown: Iterable[float | None], rate: float, *beside: Path) -> dict[str, Any]:
    """What ``--json`` says: the file that each frame is in, where in the capture the frame is, and the size of all."""
    frames = [
        {"path": str(file), "frame": frame, "seconds": None if frame is None else frame / rate}
        for file, frame in zip(files, shown, strict=True)
    ]
    return {"frames": frames, "bytes": sum(file.stat().st_size for file in {*files, *beside})}


Render = Callable[[Sequence[int]], Iterator[Path]]
"""Renders some of the views that were asked for, by their indices; see ``render_views``."""


def _opened(asked: Mapping[str, Any]) -> tuple[Render, list[Path], Callable[[], dict[str, Any]]]:
    """A scene that is ready to be rendered, the file of each view, and what ``--json`` says at the end, by the values
    of the command's options."""
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.render_files import image_files, render_views
    from ..engine.scene.scene_file import read_scene

    file, out, background = read_scene(asked["scene"]), asked["out"], asked["background"]
    scene, timing = edited_scene(ScenePlayer(file), asked["edits"])
    if asked["edits"] and asked["canonical"]:
        raise UsageError("--canonical: found --edits, expected one of them: edits are made for frames.")
    _draw_on(asked["device"])
    shown = scene.canonical() if asked["canonical"] else scene
    views = _views(asked, scene, timing)
    look = {"background": background, "alpha": asked["alpha"], "full_precision": asked["float"]}
    look["vectors"] = asked["vectors"]
    files = image_files(views, out)
    told = partial(_written, files, [view.frame for view in views], scene.header.frames_per_second)
    return lambda chosen: render_views(shown, views, out, **look, chosen=chosen), files, told


def _views(asked: Mapping[str, Any], scene: ScenePlayer, timing: Timing | None) -> list[View]:
    """What is to be rendered, at its size."""
    from ..engine.playback.render_files import camera_at
    from ..engine.playback.views import View, read_cameras, sized, views_at

    file, header, size = asked["cameras"], scene.header, asked["size"]
    cameras = read_cameras(file, header) if file else []
    views = [view for view in cameras if isinstance(view, View)]
    if views:
        if asked["times"] or asked["step"]:
            raise UsageError(f"{file}: found --times or --step, expected none of them: the file says its frames.")
        wanted = frames_of(asked["frames"], max(view.number for view in views) + 1)
        views = [view for view in views if asked["frames"] is None or view.number in wanted]
    elif len(cameras) > 1 and not (asked["frames"] or asked["times"]):
        expected = "--frames or --times with as many, or a single one"
        raise found_instead(
            file, f"{len(cameras)} cameras and not which frame each shows", f'{expected}, or a "frame" with each camera'
        )
    else:
        frames = _frames(asked, header.frame_count, timing)
        if asked["camera"]:
            at = camera_at(header, asked["camera"])
            views = [View(number, frame, at(frame or 0.0)) for number, frame in frames]
        else:
            views = views_at([camera for camera in cameras if isinstance(camera, Camera)], frames)
    if size is None:
        return views

    def resized(camera: Camera) -> Camera:
        return sized(camera, *size) if isinstance(size, tuple) else camera.scaled(size)

    return [replace(view, camera=resized(view.camera)) for view in views]


def _frames(asked: Mapping[str, Any], count: int, timing: Timing | None) -> list[tuple[int, float | None]]:
    """Numbers of images, counted from 0 where they are not those of whole frames, and the capture's frame in each."""
    times, step = asked["times"], asked["step"] or 1
    if times and (asked["frames"] or asked["step"]):
        raise UsageError("--times: found --frames or --step, expected one or the other.")
    if timing is not None and (times or step % 1):
        raise UsageError("--edits: found a timing and --times or a fraction as --step, expected whole frames.")
    frames = frames_of(asked["frames"], count if timing is None else len(timing.frames))
    shown = [frames[0] + index * step for index in range(int((len(frames) - 1) / step + 1e-9) + 1)]
    if timing is not None:
        return [(int(frame), timing.frames[int(frame)]) for frame in shown]
    if times or step % 1:
        return list(enumerate(shown if not times else [time * (count - 1) for time in times]))
    return [(int(frame), frame) for frame in shown]


def _on_cluster(options: argparse.Namespace, count: int, report: Callable[[int, int], None]) -> None:
    """Renders views on the workers of a cluster, in parts that are small enough to keep all of them busy."""
    from ..engine.distributed.cluster import Ended

    asked = {name: value for name, value in vars(options).items() if not callable(value)}
    asked |= {name: value.resolve() for name, value in asked.items() if isinstance(value, Path)}
    done: set[int] = set()
    with opened_cluster(options.scheduler, options.jobs) as cluster:
        size = max(1, count // (_PARTS_A_SLOT * cluster.slots))
        parts = [range(count)[first : first + size] for first in range(0, count, size)]
        tasks = ((f"images {part[0]}", {**asked, "chosen": part}) for part in parts)
        for _, message in cluster.messages(render_part, tasks):
            if not isinstance(message, Ended):
                done.add(message)
                report(len(done), count)
            elif message.error is not None:
                raise FrogError(message.error)


def render_part(task: Mapping[str, Any], say: Callable[[int], None], cancelled: Callable[[], bool]) -> None:
    """Renders some views as a task of a cluster; says the index of each."""
    render, *_ = _opened(task)
    images = render(task["chosen"])
    for index in task["chosen"]:
        if cancelled():
            return
        next(images)
        say(index)


def _draw_on(device: str) -> None:
    """Has this process draw on a device: "cpu", "cuda" or "auto". FrogError where it cannot be used."""
    from ..engine.playback.painter import painter

    painter().gpu = None  # which an earlier task may have had; without torch
    if device != "cpu":
        from ..engine.training.optimize.device import draw_frames_on

        if warning := draw_frames_on(device):
            print(f"warning: {warning}", file=sys.stderr)


def add_export_parser(commands: Any) -> None:
    """Adds the command."""
    export = commands.add_parser("export", help="write a scene for other programs")
    add_scene_arguments(export)
    export.add_argument(
        "--out", type=Path, required=True, metavar="PATH", help="folder of a file for each frame, or file"
    )
    kinds = export.add_mutually_exclusive_group()
    for name, meaning in (
        ("usd", "one .usdc, .usda or .usd file that plays, with cameras and the sound's path"),
        ("html", "one .html file that plays in a browser, with sound"),
        ("compressed-ply", "a .compressed.ply file for each frame, a quarter as large"),
        ("sog", "a .sog file for each frame, for the web: the smallest"),
        ("spz", "a compressed .spz file for each frame"),
        ("glb", "a glTF file for each frame, with KHR_gaussian_splatting"),
    ):
        kind = name.replace("-", ".")
        kinds.add_argument(f"--{name}", dest="kind", action="store_const", const=kind, default="ply", help=meaning)
    export.add_argument(
        "--float", action="store_true", help="--usd in single precision; default: half, but for positions"
    )
    export.add_argument(
        "--spz-version", type=int, choices=(2, 3, 4), help="fewer programs read 3, fewer still 4; default: 2"
    )
    export.add_argument(
        "--folder", action="store_true", help="--html for a server: a folder of a page and its data, which plays early"
    )
    export.add_argument("--spz-coarse", action="store_true", help="half as large, in the precision of other programs")
    export.add_argument("--silent", action="store_true", help="without sound")
    export.add_argument(
        "--y-down",
        action="store_true",
        help="rotate .ply and .sog files of a scene whose z axis points up so that its y axis points down, as most "
        "viewers expect; default: the scene's own axes",
    )
    add_json_argument(export)
    export.set_defaults(run=_export)


_OF_FORMATS = {
    "y_down": (("ply", "compressed.ply", "sog"), "a format that says itself which way is up", ".ply or .sog files"),
    "float": (("usd",), "a format with a precision of its own", "--usd"),
    "spz_version": (("spz",), "another format", "--spz"),
    "folder": (("html",), "another format", "--html"),
    "spz_coarse": (("spz",), "another format", "--spz"),
    "silent": (("usd", "html"), "a format without sound", "--usd or --html"),
}
"""Arguments that some formats alone know: which these are, and how a sentence calls others and these."""


def _export(options: argparse.Namespace) -> int:
    from ..engine.editing.edited_scene import RetimedScene
    from ..engine.interchange.take import scene_take
    from ..engine.playback.player import ScenePlayer

    for name, (kinds, others, expected) in _OF_FORMATS.items():
        if getattr(options, name) and options.kind not in kinds:
            raise UsageError(f"--{name.replace('_', '-')}: found {others}, expected {expected}.")
    scene, timing = edited_scene(ScenePlayer.load(options.scene), options.edits)
    frames = frames_of(options.frames, scene.header.frame_count if timing is None else len(timing.frames))
    if options.kind in ("usd", "html"):
        _export_take(options, scene_take(scene, options.scene.stem, frames, timing))
    else:
        files = _export_frames(options, scene if timing is None else RetimedScene(scene, timing), frames)
        shown = frames if timing is None else [timing.frames[frame] for frame in frames]
        options.figures = _written(files, shown, scene.header.frames_per_second)
    return 0


def _export_take(options: argparse.Namespace, take: Take) -> None:
    from ..engine.interchange.take import with_sound
    from ..engine.interchange.usd_export import rate_to_set, write_usd
    from ..engine.interchange.web_page.page import DATA, PAGE, write_page
    from .progress import bar

    if not options.silent:
        take = with_sound(take, options.scene)
    is_page, path = options.kind == "html", options.out
    with bar("Exporting") as report:
        for done in (
            write_page(path, take, folder=options.folder)
            if is_page
            else write_usd(path, take, full_precision=options.float)
        ):
            report(done, len(take.numbers))
    file, beside = (path / DATA, [path / PAGE]) if options.folder else (path, [])
    options.figures = _written([file] * len(take.numbers), take.shown, take.header.frames_per_second, *beside)
    size = options.figures["bytes"] / 1e6
    say(f"{len(take.numbers)} frames in {path}, {size:,.1f} MB{', with sound' if take.sound else ''}")
    if not is_page and len(take.numbers) > 1:
        say(rate_to_set(take))


def _export_frames(options: argparse.Namespace, scene: PlayedFrames, frames: range) -> list[Path]:
    """Writes a file for each; returns them."""
    from ..engine.interchange.frame_files import export_frames
    from ..engine.interchange.spz import VERSIONS, Spz
    from ..engine.playback.transform import Y_DOWN
    from .progress import bar

    path = options.out / f"{options.scene.stem}.{options.kind}"
    if options.out.suffix == path.suffix and not options.out.is_dir():
        raise UsageError(f"{options.out}: found the name of a file, expected a folder: each frame has a file.")
    files = list[Path]()
    turn = Y_DOWN if options.y_down else None
    spz = Spz(options.spz_version or VERSIONS[0], options.spz_coarse)
    with bar("Exporting") as report:
        for file in export_frames(scene, frames, path, turn=turn, spz=spz):
            files.append(file)
            report(len(files), len(frames))
    say(f"{len(frames)} files in {options.out}")
    return files


def add_import_parser(commands: Any) -> None:
    """Adds the command."""
    imported = commands.add_parser("import", help="make a scene of other programs' Gaussians")
    imported.add_argument("splats", type=Path, action=Reads, metavar="FILE", help="or a folder or .zip of .ply frames")
    imported.add_argument("--out", type=Path, metavar="X.frog", help="default: beside the file")
    imported.add_argument("--fps", type=positive(float), help="of .ply files that move, .splatv; default: 30")
    imported.add_argument("--packed", action="store_true", help="several times smaller, without a visible difference")
    add_json_argument(imported)
    imported.set_defaults(run=_import)


def _import(options: argparse.Namespace) -> int:
    from ..engine.interchange.imports import RATE, free_scene_path, import_scene, says_no_rate, was_imported_from
    from ..engine.training.session.output_paths import check_unused
    from .progress import bar

    if options.fps and options.splats.is_file() and not says_no_rate(options.splats):
        raise UsageError("--fps: found a file with frames at times of its own or a single one, expected .ply frames.")
    target, rate = options.out or free_scene_path(options.splats), options.fps or RATE
    if not was_imported_from(options.splats, target):
        check_unused(target)
    with bar("Importing") as report:
        imported = import_scene(options.splats, target, compact=options.packed, rate=rate, progress=report)
    counts = {"gaussians": imported.gaussians, "frames": imported.frames, "bytes": imported.path.stat().st_size}
    options.figures = {"scene": str(imported.path), **counts, "warnings": [imported.warning] * bool(imported.warning)}
    frames = f", {imported.frames:,} frames" if imported.frames > 1 else ""
    say(f"{imported.gaussians:,} Gaussians{frames} in {imported.path}")
    if imported.warning:
        say(imported.warning)
    return 0
