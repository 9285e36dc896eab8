"""A scene trained under a budget of Gaussians against a larger one cut down to it by opacity, as is usual elsewhere.

    python benchmarks/budget.py CAPTURE... [--budget 20000] [--full 40000] [--recipe draft] [--steps N] [--scale S]
                                [--seed 0]

One JSON object a capture: Gaussians and PSNR on the held-out images of the scene under the budget, of the full one,
and of the full one without its most transparent Gaussians.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from frog_blender.engine.evaluation.evaluate import evaluate_file
from frog_blender.engine.playback.player import select_gaussians
from frog_blender.engine.recipes import recipe
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.training.compression.budget import with_budget
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


def train(options: argparse.Namespace, capture: Path, output: Path, budget: int | None = None) -> Path:
    """A training of the full scene, or of one with at most so many Gaussians."""
    settings = recipe(options.recipe, capacity="auto", max_gaussians=options.full)
    if budget:
        settings = with_budget(settings, budget, "frog")
    job = TrainingJob(
        capture, output, recipe=settings, steps=options.steps, seed=options.seed, scale=options.scale, overwrite=True
    )
    for _ in run_training(job):
        pass
    return output


def without_transparent(path: Path, output: Path, count: int) -> Path:
    """The scene with its ``count`` most opaque Gaussians."""
    scene = read_scene(path)
    kept = np.sort(np.argsort(-scene.arrays["opacity_logits"], kind="stable")[:count])
    write_scene(output, select_gaussians(scene, kept))
    return output


def figures(path: Path, capture: Path) -> dict[str, Any]:
    found = evaluate_file(path, capture)
    names = ("gaussians", "psnr", "psnr_moving")
    return {name: found[name] if name == "gaussians" else round(found[name], 2) for name in names if found.get(name)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--budget", type=int, default=20_000)
    parser.add_argument("--full", type=int, default=40_000)
    parser.add_argument("--recipe", default="draft")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--scale", type=float)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for capture in options.captures:
        with tempfile.TemporaryDirectory() as folder:
            here = Path(folder)
            budget = train(options, capture, here / "budget.frog", options.budget)
            full = train(options, capture, here / "full.frog")
            cut = without_transparent(full, here / "cut.frog", options.budget)
            found = {name: figures(path, capture) for name, path in (("budget", budget), ("full", full), ("cut", cut))}
        print(json.dumps({"capture": capture.name, "seed": options.seed, **found}), flush=True)


if __name__ == "__main__":
    main()
