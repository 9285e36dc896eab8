"""``frog render``: frames of a scene as image files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from .arguments import add_edits_argument, add_frames_argument, edited_scene, frames_of
from .printing import say

if TYPE_CHECKING:
    from ..engine.playback.render_files import FrameRenderer
    from ..engine.scene.scene_file import SceneFile


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
    render.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    from ..engine.editing.retimed_scene import RetimedScene
    from ..engine.playback.player import ScenePlayer
    from ..engine.playback.render_files import cpu_renderer, render_frames
    from ..engine.scene.scene_file import read_scene
    from .progress import bar

    scene = read_scene(options.scene)
    timing, shown = None, None
    if options.edits is not None:
        if options.device == "cuda":
            raise FrogError("--edits: found --device cuda, expected cpu, which alone makes edits.")
        played, timing = edited_scene(ScenePlayer(scene), options.edits)
        renderer = cpu_renderer(played if timing is None else RetimedScene(played, timing))
        shown = None if timing is None else timing.capture_frame
    else:
        renderer = frame_renderer(scene, options.device)
    frames = frames_of(options.frames, scene.header.frame_count if timing is None else len(timing.frames))
    with bar("Rendering") as report:
        paths = render_frames(
            scene, options.camera, frames, options.out, renderer=renderer, shown=shown, progress=report
        )
    say(f"{len(paths)} images in {options.out}")
    return 0


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
