"""Trains a capture over several seeds and prints one JSON line a run, then the medians.

    python benchmarks/quality.py CAPTURE [--recipe draft] [--capacity auto] [--method frog] [--seeds 3]
                                 [--holdout-frames K] [--scale S] [--device auto]

Decoding and seeding are timed apart from training; the machine should be quiet. Without the native library, as on a
machine that only trains on its GPU, the PSNR is the training's own (of at most 30 images) and the rest is left out.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from frog_blender.engine.errors import FrogError
from frog_blender.engine.evaluation.evaluate import evaluate_file
from frog_blender.engine.native import binding
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session.events import Event, Finished, Started
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

FIGURES = (
    "psnr",
    "psnr_moving",
    "ssim",
    "sharpness_moving",
    "gaussians",
    "bytes",
    "train_seconds",
    "preparation_seconds",
)


def run(options: argparse.Namespace, seed: int, folder: Path) -> dict[str, Any]:
    """One training and its figures on the held-out images."""
    output = folder / f"{seed}.frog"
    started, preparation = time.monotonic(), 0.0
    job = TrainingJob(
        options.capture,
        output,
        method=options.method,
        recipe=recipe(options.recipe, capacity=options.capacity),
        steps=options.steps,
        seconds=options.seconds,
        seed=seed,
        overwrite=True,
        scale=options.scale,
        holdout_frames=options.holdout_frames,
        device=options.device,
    )
    last: Event | None = None
    device = ""
    for last in run_training(job):
        if isinstance(last, Started):
            preparation, device = time.monotonic() - started, last.device
    assert isinstance(last, Finished)
    result: dict[str, Any] = {"psnr": last.psnr, "gaussians": last.gaussians, "train_seconds": last.seconds}
    if has_native_library():
        result = evaluate_file(output, options.capture)
        del result["cameras"]
    start = {"seed": seed, "recipe": options.recipe, "device": device, "preparation_seconds": preparation}
    return {**start, "bytes": output.stat().st_size, "steps": last.steps, **result}


def has_native_library() -> bool:
    """True where finished scenes can be drawn on the CPU."""
    try:
        binding.library()
    except FrogError:
        return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--recipe", default="draft")
    parser.add_argument("--capacity", choices=["auto", "fixed"], default="auto")
    parser.add_argument("--method", default="frog")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--scale", type=float)
    parser.add_argument("--holdout-frames", type=int)
    parser.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for seed in range(options.seeds):
            runs.append(run(options, seed, Path(folder)))
            print(json.dumps(runs[-1]), flush=True)
    medians = {}
    for name in FIGURES:
        values = [run[name] for run in runs if run.get(name) is not None]
        if values:
            medians[name] = round(statistics.median(values), 4)
    print(json.dumps({"median of": len(runs), **medians}))


if __name__ == "__main__":
    main()
