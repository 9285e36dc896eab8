"""Times the parts of a training's steps, from its first to its last, in a shortened training.

    python benchmarks/step.py CAPTURE [--recipe standard] [--steps 1500] [--threads 2] [--scale S]

One JSON object for each tenth of the training and one for all of it: milliseconds a step of the rasterizer and of the
deformation network, forward and backward, of the optimiser, of the rounds of density control and sampling, and of
everything else; and the share of what is neither rasterizer nor network. Schedules and rounds are fractions of
training, so a shortened training passes through the same sizes as a whole one.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from frog_blender.engine.capture.seeds import SeedSettings, find_seeds
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.memory import gc_frozen
from frog_blender.engine.model import fused
from frog_blender.engine.native import binding
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import add_hooks, prepare_capture

WARM_UP = 10  # steps that are left out of the first tenth
PARTS = ("rasterizer_forward", "rasterizer_backward", "network_forward", "network_backward", "optimizer", "rounds")


def watch(spent: Counter[str], owner: Any, name: str, label: str) -> None:
    """Adds the seconds of every call of ``owner.name`` to ``spent[label]``; what is watched inside counts there."""
    function: Callable[..., Any] = getattr(owner, name)

    def timed(*arguments: Any, **keywords: Any) -> Any:
        inside, started = sum(spent.values()), time.perf_counter()
        try:
            return function(*arguments, **keywords)
        finally:
            spent[label] += time.perf_counter() - started - (sum(spent.values()) - inside)

    setattr(owner, name, timed)


def figures(spent: Counter[str], seconds: float, steps: int) -> dict[str, float]:
    """Milliseconds a step by part."""
    network_and_rasterizer = sum(spent[part] for part in PARTS[:4])
    result = {f"{part}_ms": round(1e3 * spent[part] / steps, 2) for part in PARTS}
    result["else_ms"] = round(1e3 * (seconds - sum(spent.values())) / steps, 2)
    result["step_ms"] = round(1e3 * seconds / steps, 2)
    return result | {"outside_share": round(1 - network_and_rasterizer / seconds, 3)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--recipe", default="standard")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--threads", type=int, default=0, help="0: one for each core")
    parser.add_argument("--scale", type=float)
    options = parser.parse_args()
    binding.set_thread_count(options.threads)
    if options.threads:
        torch.set_num_threads(options.threads)
    capture, _ = prepare_capture(TrainingJob(options.capture, Path("x.frog"), scale=options.scale))
    store = FrameStore.open(capture)
    settings = recipe(options.recipe)
    seeds = find_seeds(capture, store, SeedSettings(settings.seed_gaussians))
    trainer = Trainer(capture, store, seeds, settings, JobOptions(steps=options.steps))
    add_hooks(trainer)
    spent: Counter[str] = Counter()
    watch(spent, binding.Frame, "__init__", "rasterizer_forward")
    watch(spent, binding.Frame, "backward", "rasterizer_backward")
    watch(spent, fused, "deform", "network_forward")
    watch(spent, fused, "deform_backward", "network_backward")
    watch(spent, trainer.optimizer, "step", "optimizer")
    watch(spent, trainer.density, "round", "rounds")
    watch(spent, trainer.smoothness, "resample", "rounds")
    watch(spent, trainer, "inject_anchors", "rounds")
    for hook in trainer.hooks:
        watch(spent, hook, "after_step", "rounds")
    about = {"recipe": options.recipe, "isa": binding.instruction_set()}
    total, all_seconds, all_steps = Counter[str](), 0.0, 0
    with gc_frozen():  # as in a training
        while trainer.step_count < WARM_UP:
            trainer.step()
        for tenth in range(10):
            end = options.steps * (tenth + 1) // 10
            spent.clear()
            steps, started = end - trainer.step_count, time.perf_counter()
            while trainer.step_count < end:
                trainer.step()
            seconds = time.perf_counter() - started
            about |= {"tenth": tenth + 1, "gaussians": trainer.count}
            print(json.dumps({**about, **figures(spent, seconds, steps)}))
            total, all_seconds, all_steps = total + spent, all_seconds + seconds, all_steps + steps
    print(json.dumps({**about, "tenth": "all", **figures(total, all_seconds, all_steps)}))


if __name__ == "__main__":
    main()
