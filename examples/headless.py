"""Train a capture and render it, without a window:

    blender -b --python examples/headless.py -- CAPTURE OUT [--recipe draft] [--steps N]
    python examples/headless.py CAPTURE OUT [--recipe draft] [--steps N]      (with the bpy module)

The add-on is the one that this Blender has installed, else the one beside this folder.
Writes OUT/scene.frog, OUT/scene.blend and the animation OUT/frames/0001.png ...
Leaves with status 1 and one sentence when something cannot be done.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy

import addon_utils  # isort: skip  # which the bpy module makes importable

NAME = "frog_blender"


def installed() -> str | None:
    """The module of the add-on that this Blender has, whether as an extension or not: the one that is on, if any."""
    known = [module.__name__ for module in addon_utils.modules()]
    names = [name for name in known if name.split(".")[-1] == NAME]
    return next((name for name in names if name in bpy.context.preferences.addons), next(iter(names), None))


def switched_on() -> tuple[ModuleType, bool]:
    """The add-on, and whether it was switched on here: then it is to be switched off again."""
    name = installed()
    if name is not None:
        was_on = addon_utils.check(name)[1]
        if not was_on:
            addon_utils.enable(name)
        return import_module(name), not was_on
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    addon = import_module(NAME)
    addon.register()
    return addon, True


def switch_off(addon: ModuleType) -> None:
    if addon_utils.check(addon.__name__)[1]:
        addon_utils.disable(addon.__name__)
    else:
        addon.unregister()


def arguments() -> argparse.Namespace:
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(prog="headless.py", description="Train a capture and render it, without a window.")
    parser.add_argument("capture", type=Path, help="folder with the videos and cameras")
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--recipe", default="draft", choices=("draft", "standard", "paper"))
    parser.add_argument("--steps", type=int, help="training steps instead of the recipe's own number")
    return parser.parse_args(given)


def train(options: argparse.Namespace, part: Any) -> Path:
    """Train to OUT/scene.frog, saying how it goes; FrogError if it does not. ``part`` gives modules of the add-on."""
    part("ui.preferences").make_torch_importable()
    output = options.out.resolve() / "scene.frog"
    capture, what = options.capture.resolve(), {"capacity": "auto", "steps": options.steps}
    request = part("tasks.training_request").TrainingRequest(capture, output, options.recipe, **what)
    task = part("tasks.training").begin(request.events)
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
        raise part("engine.errors").FrogError(state.error or "Training ended without a scene.")
    quality = f", PSNR {state.psnr:.2f} dB on {state.psnr_split} views" if state.psnr is not None else ""
    print(f"Trained {state.step} steps in {state.seconds:.0f} s{quality}: {state.result}", flush=True)
    return Path(state.result)


def show_and_render(path: Path, out: Path, part: Any) -> None:
    """The scene as Blender objects, saved and rendered."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    part("scene_import.create_objects").import_scene(path, scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "scene.blend"))
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = f"{out}/frames/"
    try:
        bpy.ops.render.render(animation=True)
    except RuntimeError as error:
        raise part("engine.errors").FrogError(str(error).strip().splitlines()[0]) from error
    print(f"Rendered {scene.frame_end - scene.frame_start + 1} frames to {out / 'frames'}", flush=True)


def main() -> int:
    options = arguments()
    addon, is_ours = switched_on()

    def part(name: str) -> ModuleType:
        return import_module(f"{addon.__name__}.{name}")

    try:
        path = train(options, part)
        show_and_render(path, options.out.resolve(), part)
    except part("engine.errors").FrogError as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    finally:
        if is_ours:
            switch_off(addon)
    return 0


if __name__ == "__main__":
    if main():
        sys.exit(1)  # and not otherwise: a Blender with a window stays open
