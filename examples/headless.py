"""Train a capture and render it, without a window:

    blender -b --python examples/headless.py -- CAPTURE OUT [--recipe draft] [--steps N]
    python examples/headless.py CAPTURE OUT [--recipe draft] [--steps N]      (with the bpy module)

Writes OUT/scene.frog, OUT/scene.blend and the animation OUT/frames/0001.png ...
Leaves with status 1 and one sentence when something cannot be done.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy

import frog_blender
from frog_blender import background
from frog_blender.engine.errors import FrogError
from frog_blender.operators.materialize import materialize
from frog_blender.ui.preferences import make_torch_importable


def arguments() -> argparse.Namespace:
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(prog="headless.py", description="Train a capture and render it, without a window.")
    parser.add_argument("capture", type=Path, help="folder with the videos and cameras")
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--recipe", default="draft", choices=("draft", "standard", "paper"))
    parser.add_argument("--steps", type=int, help="training steps instead of the recipe's own number")
    return parser.parse_args(given)


def train(options: argparse.Namespace) -> Path:
    """Train to OUT/scene.frog, saying how it goes; FrogError if it does not."""
    make_torch_importable()
    output = options.out.resolve() / "scene.frog"
    request = background.TrainingRequest(options.capture.resolve(), output, options.recipe, steps=options.steps)
    task = background.begin(request.events)
    state, said, warned = task.state, "", 0
    while state.running:
        if not task.pump():
            time.sleep(0.05)
        now = state.stage if state.stage else f"{10 * int(10 * state.fraction)} %"
        if now != said:
            said = now
            loss = f", loss {state.loss:.4f}, {state.gaussians:,} Gaussians" if state.loss is not None else ""
            print(f"{now}{loss}", flush=True)
        for warning in state.warnings[warned:]:
            print(f"Note: {warning}", flush=True)
        warned = len(state.warnings)
    if state.error or state.result is None:
        raise FrogError(state.error or "Training ended without a scene.")
    quality = f", PSNR {state.psnr:.2f} dB on {state.psnr_split} views" if state.psnr is not None else ""
    print(f"Trained {state.step} steps in {state.seconds:.0f} s{quality}: {state.result}", flush=True)
    return state.result


def show_and_render(path: Path, out: Path) -> None:
    """The scene as Blender objects, saved and rendered."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    materialize(path, scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "scene.blend"))
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = f"{out}/frames/"
    try:
        bpy.ops.render.render(animation=True)
    except RuntimeError as error:
        raise FrogError(str(error).strip().splitlines()[0]) from error
    print(f"Rendered {scene.frame_end - scene.frame_start + 1} frames to {out / 'frames'}", flush=True)


def main() -> int:
    options = arguments()
    frog_blender.register()
    try:
        path = train(options)
        show_and_render(path, options.out.resolve())
    except FrogError as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    finally:
        frog_blender.unregister()
    return 0


if __name__ == "__main__":
    if main():
        sys.exit(1)  # and not otherwise: a Blender with a window stays open
