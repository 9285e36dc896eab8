"""``frog info``, ``frog eval``, ``frog render``: what a capture or a scene holds, how good it is, how it looks."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from .arguments import add_offset_argument, offsets_of
from .printing import say


def add_view_parsers(commands: Any) -> None:
    """Adds the three commands."""
    info = commands.add_parser("info", help="say what a capture or a .frog holds")
    info.add_argument("path", type=Path)
    info.add_argument("--json", action="store_true")
    add_offset_argument(info)
    info.set_defaults(run=_info)

    evaluate = commands.add_parser("eval", help="compare a scene with the capture's images")
    evaluate.add_argument("scene", type=Path)
    evaluate.add_argument("capture", type=Path)
    evaluate.add_argument("--mask", type=Path, help="an image, or an .npz with a mask for each camera")
    evaluate.add_argument("--split", choices=["auto", "held-out", "training"], default="auto")
    evaluate.add_argument("--perceptual", action="store_true", help="FLIP and LPIPS too, where they can be computed")
    evaluate.add_argument("--json", action="store_true")
    evaluate.set_defaults(run=_eval)

    render = commands.add_parser("render", help="draw frames of a scene as one of its cameras saw them")
    render.add_argument("scene", type=Path)
    render.add_argument("--camera", required=True)
    render.add_argument("--frames", default=None, metavar="A:B", help="frames A to B - 1, counted from 0; default: all")
    render.add_argument("--out", type=Path, required=True)
    render.add_argument(
        "--device",
        choices=["cpu", "cuda", "auto"],
        default="cpu",
        help="cuda (experimental) and auto need torch; default: cpu",
    )
    render.set_defaults(run=_render)


def _info(options: argparse.Namespace) -> int:
    from .actions import describe

    description = describe(options.path, offsets_of(options))
    if options.json:
        print(json.dumps(description, indent=1))
    else:
        for key, value in description.items():
            for line in value if isinstance(value, list) else [value]:
                say(f"{key:>14}  {line}")
    return 0


def _eval(options: argparse.Namespace) -> int:
    from .actions import evaluate_file
    from .progress import bar

    with bar("Evaluating") as report:
        result = evaluate_file(
            options.scene, options.capture, options.split, options.mask, report, perceptual=options.perceptual
        )
    if options.json:
        print(json.dumps(result, indent=1))
        return 0
    for key, reason in result.pop("missing", {}).items():
        result[key] = f"- ({reason})"
    for key, value in result.items():
        if key != "cameras":
            say(f"{key:>18}  {value:.4f}" if isinstance(value, float) else f"{key:>18}  {value}")
    return 0


def _render(options: argparse.Namespace) -> int:
    from .actions import render_frames
    from .progress import bar

    with bar("Rendering") as report:
        count = render_frames(options.scene, options.camera, options.frames, options.out, report, options.device)
    say(f"{count} images in {options.out}")
    return 0
