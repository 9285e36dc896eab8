"""``frog render``, ``frog export`` and ``frog import``: frames of a scene as images, and other programs' formats."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError, UsageError
from .arguments import add_scene_arguments, add_scheduler_argument, edited_scene, frames_of, opened_cluster, positive
from .terminal import say

if TYPE_CHECKING:
    from ..engine.interchange.take import Take
    from ..engine.playback.render_files import FrameRenderer, PlayedFrames
    from ..engine.scene.scene_file import SceneFile


_PARTS_A_SLOT = 4  # parts of a render for each task that runs at once: the last one is not waited for long


def add_render_parser(commands: Any) -> None:
    """Adds the command."""
    render = commands.add_parser("render", help="render frames of a scene as one of its cameras sees them")
    add_scene_arguments(render)
    render.add_argument("--camera", required=True)
    render.add_argument("--out", type=Path, required=True)
    render.add_argument(
        "--device", choices=["cpu", "cuda", "auto"], default="cpu", help="cuda and auto need torch; default: cpu"
    )
    add_scheduler_argument(render, "processes of --scheduler local, which share the cores")
    render.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    from .progress import bar

    render, count = _opened(options.scene, options.device, options.edits)
    frames = frames_of(options.frames, count)
    with bar("Rendering") as report:
        if options.scheduler is None:
            for done, _ in enumerate(render(options.camera, frames, options.out), 1):
                report(done, len(frames))
        else:
            _on_cluster(options, frames, report)
    say(f"{len(frames)} images in {options.out}")
    return 0


Render = Callable[[str, Sequence[int], Path], Iterator[Path]]
"""Renders frames of a scene, see ``render_frames``: of a camera, which ones, into a folder."""


def _opened(scene_file: Path, device: str, edits: Path | None) -> tuple[Render, int]:
    """A scene that is ready to be rendered, and the number of its frames as they are retimed."""
    from ..engine.editing.edited_scene import RetimedScene
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.render_files import cpu_renderer, render_frames
    from ..engine.scene.scene_file import read_scene

    scene = read_scene(scene_file)
    count = scene.header.frame_count
    shown: Callable[[int], float] = float
    if edits is None:
        renderer = frame_renderer(scene, device)
    elif device == "cuda":
        raise UsageError("--edits: found --device cuda, expected cpu, which alone makes edits.")
    else:
        played, timing = edited_scene(ScenePlayer(scene), edits)
        renderer = cpu_renderer(played if timing is None else RetimedScene(played, timing))
        if timing is not None:
            count, shown = len(timing.frames), timing.capture_frame

    def render(camera: str, frames: Sequence[int], folder: Path) -> Iterator[Path]:
        return render_frames(scene.header, camera, frames, folder, renderer, shown)

    return render, count


def _on_cluster(options: argparse.Namespace, frames: range, report: Callable[[int, int], None]) -> None:
    """Renders frames on the workers of a cluster, in parts that are small enough to keep all of them busy."""
    from ..engine.distributed.cluster import Ended

    common = {"scene": options.scene.resolve(), "camera": options.camera, "out": options.out.resolve()}
    common |= {"device": options.device, "edits": options.edits and options.edits.resolve()}
    done: set[int] = set()
    with opened_cluster(options.scheduler, options.jobs) as cluster:
        size = max(1, len(frames) // (_PARTS_A_SLOT * cluster.slots))
        parts = [frames[first : first + size] for first in range(0, len(frames), size)]
        tasks = ((f"frames {part[0]}", {**common, "frames": part}) for part in parts)
        for _, message in cluster.messages(render_part, tasks):
            if not isinstance(message, Ended):
                done.add(message)
                report(len(done), len(frames))
            elif message.error is not None:
                raise FrogError(message.error)


def render_part(task: Mapping[str, Any], say: Callable[[int], None], cancelled: Callable[[], bool]) -> None:
    """Renders some frames as a task of a cluster; says each of them."""
    render, _ = _opened(task["scene"], task["device"], task["edits"])
    for frame in task["frames"]:
        if cancelled():
            return
        list(render(task["camera"], [frame], task["out"]))
        say(frame)


def frame_renderer(scene: SceneFile, device: str) -> FrameRenderer:
    """What renders the frames of a scene on a device: "cpu", "cuda" or "auto". "cpu" needs no torch.

    Raises:
        FrogError: if the scene cannot be played, or the device cannot be used.
    """
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.render import to_uint8
    from ..engine.playback.render_files import cpu_renderer

    played = ScenePlayer(scene)
    if device != "cpu":
        from ..engine.model.torch_player import TorchScenePlayer
        from ..engine.training.optimize.device import choose_device

        chosen, warning = choose_device(device)
        if warning:
            print(f"warning: {warning}", file=sys.stderr)
        if chosen.type != "cpu" and played.num_dynamic:  # a static scene has no deformation to compute
            on_device = TorchScenePlayer(scene, chosen)
            return lambda frame, camera: to_uint8(on_device.render_image(frame, camera))
    return cpu_renderer(played)


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
        ("spz", "a compressed .spz file for each frame"),
        ("glb", "a glTF file for each frame, with KHR_gaussian_splatting"),
    ):
        kinds.add_argument(f"--{name}", dest="kind", action="store_const", const=name, default="ply", help=meaning)
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
    export.set_defaults(run=_export)


_OF_FORMATS = {
    "y_down": (("ply",), "a format that says itself which way is up", ".ply files"),
    "float": (("usd",), "a format with a precision of its own", "--usd"),
    "spz_version": (("spz",), "another format", "--spz"),
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
        _export_frames(options, scene if timing is None else RetimedScene(scene, timing), frames)
    return 0


def _export_take(options: argparse.Namespace, take: Take) -> None:
    from ..engine.interchange.take import with_sound
    from ..engine.interchange.usd_export import rate_to_set, write_usd
    from ..engine.interchange.web_page.page import write_page
    from .progress import bar

    if not options.silent:
        take = with_sound(take, options.scene)
    is_page = options.kind == "html"
    with bar("Exporting") as report:
        for done in (
            write_page(options.out, take) if is_page else write_usd(options.out, take, full_precision=options.float)
        ):
            report(done, len(take.numbers))
    size = options.out.stat().st_size / 1e6
    say(f"{len(take.numbers)} frames in {options.out}, {size:,.1f} MB{', with sound' if take.sound else ''}")
    if not is_page and len(take.numbers) > 1:
        say(rate_to_set(take))


def _export_frames(options: argparse.Namespace, scene: PlayedFrames, frames: range) -> None:
    from ..engine.interchange.frame_files import export_frames
    from ..engine.interchange.spz import VERSIONS
    from ..engine.playback.transform import Y_DOWN
    from .progress import bar

    path = options.out / f"{options.scene.stem}.{options.kind}"
    turn, version = Y_DOWN if options.y_down else None, options.spz_version or VERSIONS[0]
    with bar("Exporting") as report:
        for done, _ in enumerate(export_frames(scene, frames, path, turn=turn, spz_version=version), 1):
            report(done, len(frames))
    say(f"{len(frames)} files in {options.out}")


def add_import_parser(commands: Any) -> None:
    """Adds the command."""
    imported = commands.add_parser("import", help="make a scene of other programs' Gaussians")
    imported.add_argument("splats", type=Path, metavar="FILE", help="or a folder or .zip of .ply frames")
    imported.add_argument("--out", type=Path, metavar="X.frog", help="default: beside the file")
    imported.add_argument("--fps", type=positive(float), help="of .ply frames; default: 30")
    imported.add_argument("--packed", action="store_true", help="several times smaller, without a visible difference")
    imported.set_defaults(run=_import)


def _import(options: argparse.Namespace) -> int:
    from ..engine.interchange.imports import RATE, free_scene_path, import_scene, is_sequence
    from .progress import bar

    if options.fps and options.splats.is_file() and not is_sequence(options.splats):
        raise UsageError("--fps: found a file with frames at times of its own or a single one, expected .ply frames.")
    target, rate = options.out or free_scene_path(options.splats), options.fps or RATE
    with bar("Importing") as report:
        imported = import_scene(options.splats, target, compact=options.packed, rate=rate, progress=report)
    frames = f", {imported.frames:,} frames" if imported.frames > 1 else ""
    say(f"{imported.gaussians:,} Gaussians{frames} in {imported.path}")
    if imported.warning:
        say(imported.warning)
    return 0
