"""``frog``: the engine without a window. Exit status 0 only when it did what was asked."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .command_line.chart_command import add_chart_parser
from .command_line.extras import missing
from .command_line.scene_commands import add_scene_parsers
from .command_line.stability_command import add_stability_parser
from .engine.errors import FrogError
from .engine.files import METHODS

if TYPE_CHECKING:
    from .engine.training.recipe import Recipe

RECIPES = ("draft", "standard", "paper", "hypernerf", "technicolor")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; errors go to standard error in one sentence."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except FrogError as error:
        print(f"frog: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("frog: interrupted.", file=sys.stderr)
    except MemoryError as error:
        print(f"frog: out of memory ({error}).", file=sys.stderr)
    except ModuleNotFoundError as error:
        print(f"frog: {missing(error)}", file=sys.stderr)
    except BrokenPipeError:
        return 1
    return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="frog", description="Dynamic Gaussian scenes: train, evaluate, render.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    info = commands.add_parser("info", help="say what a capture or a .frog holds")
    info.add_argument("path", type=Path)
    info.add_argument("--json", action="store_true")
    _offset_argument(info)
    info.set_defaults(run=_info)

    train = commands.add_parser("train", help="train a scene from a capture")
    train.add_argument("capture", type=Path)
    train.add_argument("--out", type=Path, required=True, metavar="X.frog")
    train.add_argument("--method", choices=METHODS, default="frog")
    train.add_argument("--recipe", choices=RECIPES, default="standard")
    train.add_argument("--steps", type=_positive(int), help="default: the recipe's")
    train.add_argument("--seconds", type=_positive(float), help="train for this long instead")
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--scale", type=_positive(float), help="picture size factor, such as 0.5")
    train.add_argument("--holdout-frames", type=int, metavar="K", help="withhold every K-th moment; 0 withholds none")
    train.add_argument(
        "--device", choices=["auto", "cpu", "cuda"], default="auto", help="auto: the GPU where there is a usable one"
    )
    train.add_argument(
        "--capacity", choices=["auto", "fixed"], default="auto", help="auto (default): no more than the scene needs"
    )
    train.add_argument("--max-gaussians", type=_positive(int), metavar="N", help="of the scene, at most")
    train.add_argument("--max-bytes", type=_positive(int), metavar="N", help="of the .frog, with --capacity auto")
    train.add_argument("--lossless", action="store_true", help="write every number as it is; default: packed")
    train.add_argument(
        "--save-every",
        type=_positive(float),
        default=180.0,
        metavar="SECONDS",
        help="between checkpoints; default: 180",
    )
    train.add_argument(
        "--resume",
        action="store_true",
        help="go on from the checkpoint beside the .frog, with the recipe, method, capacity and so on that it began "
        "with (others are left aside, and it says so); only --steps and --seconds may be others",
    )
    _offset_argument(train)
    train.set_defaults(run=_train)

    evaluate = commands.add_parser("eval", help="compare a scene with the capture's pictures")
    evaluate.add_argument("scene", type=Path)
    evaluate.add_argument("capture", type=Path)
    evaluate.add_argument("--mask", type=Path, help="a picture, or an .npz with a mask for each camera")
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
        "--device", choices=["cpu", "cuda", "auto"], default="cpu", help="cuda and auto need torch; default: cpu"
    )
    render.set_defaults(run=_render)

    add_scene_parsers(commands)
    add_chart_parser(commands, _positive, RECIPES)
    add_stability_parser(commands, _positive, RECIPES)

    demo = commands.add_parser("demo", help="train, play and render a demo capture inside Blender's module")
    demo.add_argument("--capture", choices=["room", "dim", "fast", "walk"], default="room")
    demo.add_argument("--out", type=Path, default=Path("out"))
    demo.add_argument("--recipe", choices=RECIPES, default="standard")
    demo.add_argument("--seconds", type=_positive(float), help="of training; default: 300, and 900 for walk")
    demo.set_defaults(run=_demo)
    return parser


def _positive(kind: Callable[[str], float]) -> Callable[[str], float]:
    def parse(text: str) -> float:
        value = kind(text)
        if not 0 < value < float("inf"):
            raise argparse.ArgumentTypeError(f"{text} is not a positive number")
        return value

    return parse


def _offset_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--pixel-offset",
        action="append",
        default=[],
        metavar="CAMERA=DX,DY",
        help="where a cropped video lies in its calibrated picture",
    )


def _offsets(options: argparse.Namespace) -> dict[str, tuple[float, float]] | None:
    offsets = {}
    for text in options.pixel_offset:
        try:
            name, pair = text.split("=")
            dx, dy = pair.split(",")
            offsets[name] = (float(dx), float(dy))
        except ValueError:
            raise FrogError(f"--pixel-offset {text}: expected CAMERA=DX,DY such as cam01=8,0.") from None
    return offsets or None


def _info(options: argparse.Namespace) -> int:
    from .commands import describe

    description = describe(options.path, _offsets(options))
    if options.json:
        print(json.dumps(description, indent=1))
    else:
        for key, value in description.items():
            for line in value if isinstance(value, list) else [value]:
                print(f"{key:>14}  {line}")
    return 0


def _train(options: argparse.Namespace) -> int:
    from .command_line.progress import show
    from .engine.training.estimate import remembering
    from .engine.training.job import TrainingJob, run_training

    job = TrainingJob(
        capture=options.capture,
        output=options.out,
        method=options.method,
        recipe=_budgeted(options),
        steps=options.steps,
        seconds=options.seconds,
        seed=options.seed,
        scale=options.scale,
        holdout_frames=options.holdout_frames,
        resume=options.resume,
        pixel_offsets=_offsets(options),
        device=options.device,
        lossless=options.lossless,
        max_bytes=options.max_bytes,
        save_seconds=options.save_every,
    )
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        if stopping:
            raise KeyboardInterrupt
        stopping = True  # the first Ctrl-C saves what was learned, the second leaves at once

    previous = signal.signal(signal.SIGINT, stop)
    try:
        finished = show(remembering(run_training(job, lambda: stopping), job))
    finally:
        signal.signal(signal.SIGINT, previous)
    return 0 if finished else 1


def _budgeted(options: argparse.Namespace) -> Recipe:
    """The recipe with the capacity and the budgets that were asked for."""
    from .engine.training.budget import gaussians_within, with_budget
    from .engine.training.recipe import recipe

    chosen = recipe(options.recipe, capacity=options.capacity)
    if options.max_gaussians:
        chosen = with_budget(chosen, options.max_gaussians, options.method)
    if options.max_bytes:
        chosen = replace(chosen, max_gaussians=min(chosen.max_gaussians, gaussians_within(options.max_bytes, chosen)))
    return chosen


def _eval(options: argparse.Namespace) -> int:
    from .command_line.progress import bar
    from .commands import evaluate_file

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
            print(f"{key:>18}  {value:.4f}" if isinstance(value, float) else f"{key:>18}  {value}")
    return 0


def _render(options: argparse.Namespace) -> int:
    from .command_line.progress import bar
    from .commands import render_frames

    with bar("Rendering") as report:
        count = render_frames(options.scene, options.camera, options.frames, options.out, report, options.device)
    print(f"{count} pictures in {options.out}")
    return 0


def _demo(options: argparse.Namespace) -> int:
    from .demo import run_demo

    run_demo(options.capture, options.out, options.recipe, options.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
