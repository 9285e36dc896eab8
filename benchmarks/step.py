"""Times a training step by its parts on a capture, at a fixed number of Gaussians.

    python benchmarks/step.py CAPTURE [--recipe standard] [--count 20000] [--steps 200] [--threads 2] [--scale S]

One JSON object: milliseconds a step of the rasterizer and of the deformation network, forward and backward, of the
optimiser, and of everything else; and the share of that.
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

from frog_blender.engine.capture.frames import FrameStore
from frog_blender.engine.capture.seeds import find_seeds
from frog_blender.engine.model import fused
from frog_blender.engine.rasterizer import native
from frog_blender.engine.training.job import prepare_capture
from frog_blender.engine.training.recipe import recipe
from frog_blender.engine.training.trainer import Limits, Trainer

WARM_UP = 20  # steps


def watch(spent: Counter[str], owner: Any, name: str, label: str) -> None:
    """Adds the seconds of every call of ``owner.name`` to ``spent[label]``."""
    function: Callable[..., Any] = getattr(owner, name)

    def timed(*arguments: Any, **keywords: Any) -> Any:
        started = time.perf_counter()
        try:
            return function(*arguments, **keywords)
        finally:
            spent[label] += time.perf_counter() - started

    setattr(owner, name, timed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--recipe", default="standard")
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--threads", type=int, default=0, help="0: one for each core")
    parser.add_argument("--scale", type=float)
    options = parser.parse_args()
    native.set_thread_count(options.threads)
    if options.threads:
        torch.set_num_threads(options.threads)
    capture, _ = prepare_capture(options.capture, options.scale, None, None)
    store = FrameStore.open(capture)
    # No rounds: the number of Gaussians stays as it is.
    still = {"densify_from": 2.0, "sampling": "off", "warm_up": 0.0, "dssim_from": 0.0}
    settings = recipe(options.recipe, seed_gaussians=options.count, **still)
    seeds = find_seeds(capture, store, count_limit=options.count)
    trainer = Trainer(capture, store, seeds, settings, "frog", Limits(10**6), 0)
    for _ in range(WARM_UP):
        trainer.step()
    spent: Counter[str] = Counter()
    watch(spent, native.Frame, "__init__", "rasterizer_forward")
    watch(spent, native.Frame, "backward", "rasterizer_backward")
    watch(spent, fused, "deform", "network_forward")
    watch(spent, fused, "deform_backward", "network_backward")
    watch(spent, trainer.optimizer, "step", "optimizer")
    started = time.perf_counter()
    for _ in range(options.steps):
        trainer.step()
    total = time.perf_counter() - started
    spent["else"] = total - sum(spent.values())
    result = {"recipe": options.recipe, "gaussians": trainer.count, "isa": native.instruction_set()}
    result |= {f"{name}_ms": round(1e3 * seconds / options.steps, 2) for name, seconds in spent.items()}
    result["step_ms"] = round(1e3 * total / options.steps, 2)
    result["outside_share"] = round((spent["else"] + spent["optimizer"]) / total, 3)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
