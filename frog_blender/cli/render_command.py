"""``frog render``: frames of a scene as image files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from .arguments import add_edits_argument, add_frames_argument, edited_scene, frames_of, positive
from .cluster import add_scheduler_argument, opened_cluster
from .printing import say

if TYPE_CHECKING:
    from ..engine.playback.render_files import FrameRenderer
    from ..engine.scene.header import SceneHeader
    from ..engine.scene.scene_file import SceneFile


_PARTS_A_SLOT = 4  # parts of a render for each task that runs at once: the last one is not waited for long


def add_render_parser(commands: Any) -> None:
    """Adds the command."""
    render = commands.add_parser("render", help="render frames of a scene as one of its cameras sees them")
    render.add_argument("scene", type=Path)
    render.add_argument("--camera", required=True)
    add_frames_argument(render)
    render.add_argument("--out", type=Path, required=True)
    render.add_argument(
        "--device",
        choices=["cpu", "cuda", "auto"],
        default="cpu",
        help="cuda and auto need torch; default: cpu",
    )
    add_edits_argument(render)
    render.add_argument(
        "--jobs",
        type=positive(int),
        default=1,
        metavar="N",
        help="processes of --scheduler local, which share the cores",
    )
    add_scheduler_argument(render)
    render.set_defaults(run=_render)


@dataclass(frozen=True)
class _Opened:
    """A scene that is ready to be rendered.

    Attributes:
        renderer, shown: see ``render_frames``.
        count: of its frames, as they are retimed.
    """

    header: SceneHeader
    renderer: FrameRenderer
    shown: Callable[[int], float]
    count: int

    def render(self, camera: str, frames: Sequence[int], folder: Path) -> Iterator[Path]:
        """See ``render_frames``."""
        from ..engine.playback.render_files import render_frames

        return render_frames(self.header, camera, frames, folder, self.renderer, self.shown)


def _render(options: argparse.Namespace) -> int:
    from .progress import bar

    opened = _opened(options.scene, options.device, options.edits)
    frames = frames_of(options.frames, opened.count)
    with bar("Rendering") as report:
        if options.scheduler is None:
            for done, _ in enumerate(opened.render(options.camera, frames, options.out), 1):
                report(done, len(frames))
        else:
            _on_cluster(options, frames, report)
    say(f"{len(frames)} images in {options.out}")
    return 0


def _opened(scene_file: Path, device: str, edits: Path | None) -> _Opened:
    from ..engine.editing.edited_scene import RetimedScene
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.render_files import cpu_renderer
    from ..engine.scene.scene_file import read_scene

    scene = read_scene(scene_file)
    if edits is None:
        return _Opened(scene.header, frame_renderer(scene, device), float, scene.header.frame_count)
    if device == "cuda":
        raise FrogError("--edits: found --device cuda, expected cpu, which alone makes edits.")
    played, timing = edited_scene(ScenePlayer(scene), edits)
    if timing is None:
        return _Opened(scene.header, cpu_renderer(played), float, scene.header.frame_count)
    return _Opened(scene.header, cpu_renderer(RetimedScene(played, timing)), timing.capture_frame, len(timing.frames))


def _on_cluster(options: argparse.Namespace, frames: range, report: Callable[[int, int], None]) -> None:
    """Renders frames on the workers of a cluster, in parts that are small enough to keep all of them busy."""
    common = {"scene": str(options.scene.resolve()), "camera": options.camera, "out": str(options.out.resolve())}
    common |= {"device": options.device, "edits": options.edits and str(options.edits.resolve())}
    done: set[int] = set()

    def told(frame: int) -> None:
        done.add(frame)
        report(len(done), len(frames))

    with opened_cluster(options.scheduler, options.jobs) as cluster:
        size = max(1, len(frames) // (_PARTS_A_SLOT * cluster.slots))
        parts = [frames[first : first + size] for first in range(0, len(frames), size)]
        cluster.each(render_part, {f"frames {part[0]}": {**common, "frames": list(part)} for part in parts}, told)


def render_part(task: Mapping[str, Any], say: Callable[[int], None], cancelled: Callable[[], bool]) -> None:
    """Renders some frames as a task of a cluster; says each of them.

    Args:
        task: the paths scene, out and edits (or None), the camera's name, the device, and a list of frames.
    """
    opened = _opened(Path(task["scene"]), task["device"], Path(task["edits"]) if task["edits"] else None)
    for frame in task["frames"]:
        if cancelled():
            return
        list(opened.render(task["camera"], [frame], Path(task["out"])))
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
