"""What single frames trained alone reach in the moving pixels: roughly what the images of one frame allow.

    python benchmarks/single_frames.py CAPTURE [--frames 4] [--steps 4000] [--recipe standard] [--scale S]

Each chosen frame is trained as a static scene of its own (3DGS on that frame's training views) and scored on its
held-out image, inside the mask of what moves over the whole capture. Prints one JSON line a frame and the mean error
of all in decibels, which is how ``psnr_moving`` averages a whole scene.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.seeds import SeedSettings, find_seeds
from frog_blender.engine.evaluation.masks import moving_mask
from frog_blender.engine.evaluation.metrics import psnr_of
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import Recipe, recipe
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import prepare_capture


def trained_alone(capture: Capture, frame: int, recipe: Recipe, steps: int, seed: int) -> Trainer:
    """A static scene of one frame."""
    alone = capture.segment(frame, 1)
    store = FrameStore.open(alone)
    seeds = find_seeds(alone, store, SeedSettings(recipe.seed_gaussians, seed=seed))
    trainer = Trainer(alone, store, seeds, recipe, JobOptions(method="static", steps=steps, seed=seed))
    while not trainer.finished:
        trainer.step()
    return trainer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--frames", type=int, default=4, help="frames, evenly spread")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--recipe", default="standard")
    parser.add_argument("--scale", type=float)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    capture, _ = prepare_capture(TrainingJob(options.capture, Path("x.frog"), scale=options.scale))
    store = FrameStore.open(capture)
    held_out = [i for i, camera in enumerate(capture.cameras) if camera.name in capture.test_cameras]
    shots = {c: [i for i, shot in enumerate(capture.shots) if shot.camera == c] for c in held_out}
    masks = {c: moving_mask(store, shots[c]) for c in held_out}
    by_name = {capture.cameras[c].name: c for c in held_out}
    errors: list[float] = []
    for frame in np.linspace(0, capture.frame_count - 1, options.frames + 2)[1:-1].round().astype(int):
        trainer = trained_alone(capture, int(frame), recipe(options.recipe), options.steps, options.seed)
        whole, moving = [], []
        for i, shot in enumerate(trainer.capture.shots):
            if not trainer.capture.is_test(shot):
                continue
            camera = by_name[trainer.capture.cameras[shot.camera].name]
            truth = store.image(capture.shot_index(camera, int(frame))).astype(np.float32) / 255
            error = (trainer.render_image(i).clip(0, 1).astype(np.float64) - truth) ** 2
            whole.append(error.mean())
            moving.append(error[masks[camera]].mean())
        errors.append(float(np.mean(moving)))
        figures = {"psnr": psnr_of(float(np.mean(whole))), "psnr_moving": psnr_of(errors[-1])}
        figures |= {"seconds": round(trainer.seconds, 1), "gaussians": trainer.count}
        print(json.dumps({"frame": int(frame), **figures}), flush=True)
    print(json.dumps({"frames": len(errors), "psnr_moving": psnr_of(float(np.mean(errors)))}))


if __name__ == "__main__":
    main()
