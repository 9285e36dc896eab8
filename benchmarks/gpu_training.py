"""Trainings as a GPU's speed is judged by: where their seconds go, and what quality they reach.

    python benchmarks/gpu_training.py draft CAPTURE --work DIR [--steps N] [--scale S]     a job from start to end
    python benchmarks/gpu_training.py take [--cameras 20 --frames 300 --seconds 60]        a long drawn take
    python benchmarks/gpu_training.py seed CAPTURE --work DIR --seed N [--threads N]       one figure of quality

Each prints one JSON object, ``take`` one more at every tenth of its training. ``--device cpu`` is for rehearsals.

A drawn take is a benchmark scene that swings, drawn by the GPU itself. Its images are kept decoded in memory, and the
seed points are some of the scene's own, moved by a little: reading and searching are not measured there. It is softer
than a film, and its PSNR higher: compare that with other lengths of the same take alone (``--seconds 180``).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gpu_step
import numpy as np
import raster_scenes

from frog_blender.engine.capture.seeds import Seeds
from frog_blender.engine.native import binding
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize import trainer as trainer_module
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events, run
from frog_blender.engine.training.session.job import TrainingJob

STEPS = "steps"
HOOKS = "hooks after steps: compression, snapshots"
WATCHED = {
    "density.round": "density rounds",
    "inject_anchors": "canonical field sampling",
    "smoothness.resample": "neighbours for smoothness",
    "near.prune": "near pruning",
    "least_sizes.measure_again": "least sizes",
    "evaluate": "evaluation",
    "render_image": "drawing for evaluation and previews",
}
"""What a trainer does besides steps: its methods."""
WATCHED_FUNCTIONS = {"sort_by_morton_code": "sorting", "limit_sizes": "size limits"}
"""The same, functions of the trainer's module."""
SHARE_OF_MEMORY = 0.5  # of what is free, for a take's images
SEED_NOISE = 0.02  # world units
DRAWING_SECONDS = 30.0  # of a take's images


class Watch:
    """Seconds by phase. A phase within another counts for itself alone, so all together are the time by the clock.

    Attributes:
        seconds, times: how long each took, and how often it came.
    """

    def __init__(self, phase: str, device: str) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.times = Counter[str]({phase: 1})
        self._open, self._since, self._device = [phase], time.perf_counter(), device

    def _count(self) -> None:
        now = time.perf_counter()
        self.seconds[self._open[-1]] += now - self._since
        self._since = now

    def turn_to(self, phase: str) -> None:
        """The outermost phase is another from now on."""
        if phase != self._open[0]:
            self._count()
            self._open[0] = phase
            self.times[phase] += 1

    @contextmanager
    def phase(self, name: str, waits: bool) -> Iterator[None]:
        """A block that is a phase; with ``waits`` the GPU's work of the block counts, and none from before."""
        if waits:
            gpu_step.wait(self._device)
        self._count()
        self._open.append(name)
        self.times[name] += 1
        try:
            yield
            if waits:
                gpu_step.wait(self._device)
        finally:
            self._count()
            self._open.pop()

    def watch(self, owner: Any, path: str, name: str, waits: bool = True) -> None:
        """From now on every call of a method or function of ``owner`` is a phase; nothing where it has none."""
        *between, last = path.split(".")
        for part in between:
            owner = getattr(owner, part, None)
        work: Callable[..., Any] | None = getattr(owner, last, None)
        if work is None:
            return

        def watched(*arguments: Any, **options: Any) -> Any:
            with self.phase(name, waits):
                return work(*arguments, **options)

        setattr(owner, last, watched)

    def watch_trainer(self, trainer: Trainer) -> None:
        """Its steps, and what it does besides."""
        self.watch(trainer, "step", STEPS, waits=False)
        for path, name in WATCHED.items():
            self.watch(trainer, path, name)
        add_hook = trainer.add_hook

        def adding(hook: Any) -> None:
            self.watch(hook, "after_step", HOOKS, waits=False)
            add_hook(hook)

        trainer.add_hook = adding  # type: ignore[method-assign]

    def runs(self) -> list[dict[str, Any]]:
        """A table, the longest first."""
        self._count()
        rows = sorted(self.seconds.items(), key=lambda row: -row[1])
        return [{"phase": name, "times": self.times[name], "s": round(spent, 3)} for name, spent in rows]


def draft(options: argparse.Namespace) -> dict[str, Any]:
    """A ``draft`` from opening the capture to the file, with fresh folders."""
    began = time.perf_counter()
    watch = Watch("opening", options.device)
    for name, phase in WATCHED_FUNCTIONS.items():
        watch.watch(trainer_module, name, phase)
    watch.watch(run, "choose_device", "trying the device")

    def made(*arguments: Any) -> Trainer:
        with watch.phase("making the trainer", True):
            trainer = Trainer(*arguments)
        watch.watch_trainer(trainer)
        return trainer

    own = {"steps": options.steps, "scale": options.scale, "device": options.device, "overwrite": True}
    job = TrainingJob(options.capture, options.work / "draft.frog", recipe("draft"), **own)
    result: dict[str, Any] = {}
    for event in run.run_training(job, trainer_type=made):
        if isinstance(event, events.Stage):
            watch.turn_to(event.name.lower())
        elif isinstance(event, events.Started):
            watch.turn_to("between steps")
        elif isinstance(event, events.WarningEvent):
            print(event.message, file=sys.stderr)
        elif isinstance(event, events.Finished):
            result = {"steps": event.steps, "gaussians": event.gaussians, "psnr": event.psnr}
    total = time.perf_counter() - began
    rows = watch.runs()
    in_steps = watch.seconds[STEPS]
    times = {"total_s": total, "steps_s": in_steps, "outside_s": total - in_steps}
    return {**result, **times, "ms_a_step": 1e3 * in_steps / result["steps"], "runs": rows}


def free_memory() -> float:
    """Bytes that new programs can have; infinite where the system does not say."""
    meminfo = Path("/proc/meminfo")
    lines = meminfo.read_text().splitlines() if meminfo.exists() else []
    return next((1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable")), float("inf"))


def take(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """``standard`` on a drawn take for so many seconds: how it goes, by tenths, and what it comes to."""
    size = raster_scenes.RECIPES[options.scene]
    frame_bytes = 3 * size.width * size.height * options.cameras
    frames = max(2, min(options.frames, int(SHARE_OF_MEMORY * free_memory() / frame_bytes)))
    began = time.perf_counter()
    capture, store, own, _ = gpu_step.generated(options.scene, options.device, options.cameras, frames, DRAWING_SECONDS)
    drawn = time.perf_counter() - began
    settings = recipe("standard")
    seeds = gpu_step.resampled(own, min(settings.seed_gaussians, len(own.points)))
    noise = np.random.default_rng(1).normal(scale=SEED_NOISE, size=seeds.points.shape)
    seeds = Seeds((seeds.points + noise).astype(np.float32), seeds.colors, seeds.origin)

    watch = Watch("loop", options.device)
    for name, phase in WATCHED_FUNCTIONS.items():
        watch.watch(trainer_module, name, phase)
    with watch.phase("making the trainer", True):
        trainer = Trainer(capture, store, seeds, settings, JobOptions(seconds=options.seconds), device=options.device)
    watch.watch_trainer(trainer)
    run.add_hooks(trainer)
    started, told = time.perf_counter(), 0
    while not trainer.finished and time.perf_counter() - started < 1.1 * options.seconds:
        trainer.step()
        if int(10 * trainer.progress) > told:
            told = int(10 * trainer.progress)
            gpu_step.wait(options.device)
            seconds = round(time.perf_counter() - started, 2)
            yield {"progress": told / 10, "s": seconds, "steps": trainer.step_count, "gaussians": trainer.count}
    gpu_step.wait(options.device)
    trained = time.perf_counter() - started
    trainer.check()
    psnr, split = trainer.evaluate(30)
    rows = watch.runs()
    in_steps = watch.seconds[STEPS]
    outside = trained - in_steps
    needed = settings.steps_for(options.frames)
    yield {
        "take": f"{options.cameras} x {capture.frame_count} x {size.width} x {size.height}",
        "asked": f"{options.cameras} x {options.frames}",
        "images_gb": round(frame_bytes * capture.frame_count / 1e9, 2),
        "drawn_s": round(drawn, 1),
        "trained_s": round(trained, 1),
        "steps": trainer.step_count,
        "steps_a_second": round(trainer.step_count / trained, 1),
        "ms_a_step": round(1e3 * in_steps / max(1, trainer.step_count), 3),
        "outside_s": round(outside, 2),
        "gaussians": trainer.count,
        "psnr": round(psnr, 3),
        "psnr_of": split,
        "steps_of_the_recipe": needed,
        "recipe_would_take_s": round(needed * in_steps / max(1, trainer.step_count) + outside, 1),
        "phases": ", ".join(f"{row['phase']} {row['s']} s ({row['times']})" for row in rows),
    }


def seed(options: argparse.Namespace) -> dict[str, Any]:
    """The quality of one ``draft``, for comparisons between devices."""
    from frog_blender import engine

    if options.threads:
        binding.set_thread_count(options.threads)
    output = options.work / f"{options.device}-{options.seed}-{os.getpid()}.frog"
    own = {"recipe": "draft", "steps": options.steps, "scale": options.scale, "overwrite": True}
    found = engine.train(options.capture, output, **own, device=options.device, seed=options.seed)
    figures = {"psnr": found.psnr, "gaussians": found.num_gaussians, "train_s": round(found.seconds, 1)}
    return {"device": options.device, "seed": options.seed, "steps": found.steps, **figures}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("draft", "take", "seed"))
    parser.add_argument("capture", type=Path, nargs="?")
    parser.add_argument("--work", type=Path, help="folder for what is written")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--scale", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--scene", default="100k_b", help="of a take")
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda")
    options = parser.parse_args()
    if options.what == "take":
        for record in take(options):
            print(json.dumps(record), flush=True)
        return 0
    if options.capture is None or options.work is None:
        parser.error(f"{options.what} needs a capture and --work")
    print(json.dumps(draft(options) if options.what == "draft" else seed(options)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
