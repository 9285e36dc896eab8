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
from importlib import import_module
from pathlib import Path
from types import ModuleType

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
    if getattr(addon, "__addon_enabled__", False):
        addon_utils.disable(addon.__name__)
    else:
        addon.unregister()


def arguments() -> argparse.Namespace:
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(prog="headless.py", description="Train a capture and render it, without a window.")
    parser.add_argument("capture", type=Path, help="folder with the videos and cameras")
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--recipe", default="draft", help="draft, standard, paper-exact, ...")
    parser.add_argument("--steps", type=int, help="training steps instead of the recipe's own number")
    return parser.parse_args(given)


def say(event: object) -> None:
    """Tells of a training as it goes on."""
    step, warning = getattr(event, "step", None), getattr(event, "message", None)
    if warning:
        print(f"Note: {warning}", flush=True)
    elif hasattr(event, "loss"):
        print(f"step {step}, loss {event.loss:.4f}, {event.gaussians:,} Gaussians", flush=True)


def show_and_render(path: Path, out: Path) -> None:
    """The scene as Blender objects, saved and rendered; RuntimeError with Blender's sentence where that fails."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.frog(filepath=str(path))
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "scene.blend"))
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = f"{out}/frames/"
    bpy.ops.render.render(animation=True)
    print(f"Rendered {scene.frame_end - scene.frame_start + 1} frames to {out / 'frames'}", flush=True)


def main() -> int:
    options = arguments()
    addon, is_ours = switched_on()
    engine = import_module(f"{addon.__name__}.engine")
    try:
        # Where the add-on's button has installed torch, Blender's Python does not look by itself.
        import_module(f"{addon.__name__}.ui.torch_environment").make_torch_importable()
        out = options.out.resolve()
        result = engine.train(
            options.capture.resolve(), out / "scene.frog", recipe=options.recipe, steps=options.steps, on_event=say
        )
        quality = f", PSNR {result.psnr:.2f} dB" if result.psnr is not None else ""
        print(f"Trained {result.steps} steps in {result.seconds:.0f} s{quality}: {result.path}", flush=True)
        show_and_render(result.path, out)
    except (engine.FrogError, RuntimeError) as error:
        print(str(error).strip().splitlines()[0], file=sys.stderr, flush=True)
        return 1
    finally:
        if is_ours:
            switch_off(addon)
    return 0


if __name__ == "__main__":
    if main():
        sys.exit(1)  # and not otherwise: a Blender with a window stays open
