"""How a training's step and memory grow with Gaussians, pixels, cameras and moments.

    python benchmarks/scaling.py CAPTURE [--recipe standard] [--steps 40] [--only gaussians pixels cameras moments]

One JSON object a case, each in a process of its own: the mean milliseconds of a step (some see a part of an image, some
the whole), the process's peak memory, and the bytes of decoded frames on disk. A case changes one thing of a base: all
cameras and frames, the capture's size, 20,000 Gaussians that neither grow nor are pruned. More Gaussians than seeds are
copies a little aside; larger images are the capture's, enlarged: how fast a step is does not depend on what they show.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from raster_run import resident_mb

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.seeds import Seeds, SeedSettings, find_seeds
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.memory import gc_frozen
from frog_blender.engine.native import binding
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import prepare_capture
from frog_blender.research.conditions import fewer_views

BASE = {"gaussians": 20_000, "scale": 1.0, "cameras": 0, "moments": 0}
CASES: dict[str, tuple[str, list[float]]] = {
    "gaussians": ("gaussians", [10_000, 40_000, 160_000, 640_000, 1_000_000]),
    "pixels": ("scale", [1.0, 2.0, 4.0, 8.0]),
    "cameras": ("cameras", [3, 6, 11]),
    "moments": ("moments", [8, 15, 30]),
}
WARM_UP = 10


def limited(capture: Capture, cameras: int, moments: int) -> Capture:
    """With so many training cameras, and the first so many frames; 0 for all."""
    capture = fewer_views(capture, cameras) if cameras else capture
    return capture.segment(0, moments) if moments else capture


def enough(seeds: Seeds, count: int) -> Seeds:
    """So many of them: the first, or all and copies a little aside."""
    chance, rounds = np.random.default_rng(0), -(-count // len(seeds.points))
    aside = 0.01 * np.ptp(seeds.points, axis=0)
    points = np.concatenate([seeds.points + chance.normal(size=seeds.points.shape) * aside for _ in range(rounds)])
    colors = np.tile(seeds.colors, (rounds, 1))
    return Seeds(points[:count].astype(np.float32), colors[:count], "copies")


def measure(path: Path, name: str, steps: int, case: dict[str, float]) -> dict[str, object]:
    """One case, in this process."""
    capture, _ = prepare_capture(TrainingJob(path, Path("x.frog"), scale=case["scale"]))
    capture = limited(capture, int(case["cameras"]), int(case["moments"]))
    count = int(case["gaussians"])
    settings = recipe(name, seed_gaussians=count, max_gaussians=count, densify_growth=0.0, half_size_until=0.0)
    with tempfile.TemporaryDirectory() as folder:
        store = FrameStore.open(capture, cache_folder=Path(folder))
        on_disk = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
        seeds = enough(find_seeds(capture, store, SeedSettings(20_000)), count)
        trainer = Trainer(capture, store, seeds, settings, JobOptions(steps=100 * steps))
        seconds = []
        with gc_frozen():
            for number in range(-WARM_UP, steps):
                started = time.perf_counter()
                trainer.step()
                if number >= 0:
                    seconds.append(time.perf_counter() - started)
    pixels = float(np.mean([camera.width * camera.height for camera in capture.cameras]))
    peak = resident_mb(peak=True) or math.nan
    found = {"gaussians": trainer.count, "megapixels": round(pixels / 1e6, 3), "cameras": len(capture.cameras)}
    found |= {"moments": capture.frame_count, "step_ms": round(1e3 * statistics.mean(seconds), 1)}
    found |= {"peak_gb": round(peak / 1e3, 2), "frames_gb": round(on_disk / 1e9, 2)}
    return found | {"isa": binding.instruction_set()}


def main() -> None:
    parser = argparse.ArgumentParser(prog="scaling.py", description="How a training's step and memory grow.")
    parser.add_argument("capture", type=Path)
    parser.add_argument("--recipe", default="standard")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--case", help=argparse.SUPPRESS)  # JSON, of a process that measures it
    options = parser.parse_args()
    if options.case is not None:
        print(json.dumps(measure(options.capture, options.recipe, options.steps, json.loads(options.case))))
        return
    for kind in options.only:
        what, values = CASES[kind]
        for value in values:
            command = [sys.executable, __file__, str(options.capture), "--recipe", options.recipe]
            command += ["--steps", str(options.steps), "--case", json.dumps({**BASE, what: value})]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                found = {what: value, "error": done.stderr.strip().splitlines()[-1:]}
            else:
                found = json.loads(done.stdout.splitlines()[-1])
            print(json.dumps({"kind": kind, **found}), flush=True)


if __name__ == "__main__":
    main()
