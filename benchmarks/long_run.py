"""A long session inside Blender: one training after the other, while the timeline is scrubbed. Does anything grow?

    python benchmarks/long_run.py CAPTURE [--minutes 120] [--each 300] [--scale 0.5]      (with the bpy module)
    blender -b --factory-startup --python benchmarks/long_run.py -- CAPTURE ...

Each training takes ``--each`` seconds and puts its scene into the file in place of the one before, which is then drawn
by F12 once. Prints a JSON object after each: resident memory in MB, threads, open files and Blender's data blocks, all
at rest; and at the end how much each of them grows in an hour (least squares, without the first training). Linux only:
the figures are those of /proc.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy
import numpy as np

import frog_blender
from frog_blender.engine.options import TrainingOptions
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.tasks.training_request import TrainingRequest
from frog_blender.timeline.prefetch import prefetch

SCRUB_SECONDS = 0.04  # between two frames
PATIENCE = 20  # times as long as asked for: decoding and seeds come on top, and machines stall


def held_now() -> dict[str, float]:
    """What the process holds now."""
    gc.collect()
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    blocks = sum(len(getattr(bpy.data, kind)) for kind in ("objects", "pointclouds", "meshes", "images", "cameras"))
    return {
        "megabytes": int(status["VmRSS"].split()[0]) / 1024,
        "threads": int(status["Threads"]),
        "files": len(list(Path("/proc/self/fd").iterdir())),
        "blocks": blocks,
    }


def train(request: TrainingRequest, seconds: float) -> int:
    """One training, as the panel runs it, while somebody scrubs; the frames that were shown."""
    old = list(bpy.data.objects)  # captures and their cameras
    task = TrainingTask(
        request.events, lambda path: bpy.ops.import_scene.frog(filepath=str(path), set_up_scene=True)
    ).begin()
    scene, shown, end = bpy.context.scene, 0, time.monotonic() + PATIENCE * seconds
    while task.is_running:
        if time.monotonic() > end:
            raise SystemExit(f"the training has not ended: {task.state}")
        background_task.tick()
        scene.frame_set(1 + shown % 30)
        prefetch(scene)
        shown += 1
        time.sleep(SCRUB_SECONDS)
    task.join()
    if task.error:
        raise SystemExit(task.error)
    bpy.data.batch_remove(old)
    bpy.data.orphans_purge(do_recursive=True)
    return shown


def slopes(samples: list[dict[str, Any]]) -> dict[str, float]:
    """Growth an hour of each figure."""
    later = samples[1:]
    hours = np.array([sample["minutes"] for sample in later]) / 60
    names = ("megabytes", "threads", "files", "blocks")
    return {name: round(float(np.polyfit(hours, [s[name] for s in later], 1)[0]), 3) for name in names}


def main() -> None:
    parser = argparse.ArgumentParser(prog="long_run.py", description="A long session inside Blender.")
    parser.add_argument("capture", type=Path)
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--each", type=float, default=300.0, help="seconds of a training")
    parser.add_argument("--scale", type=float, default=0.5)
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    options = parser.parse_args(words)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    frog_blender.register()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 320, 240
    began, samples = time.monotonic(), []
    with tempfile.TemporaryDirectory() as folder:
        while time.monotonic() - began < 60 * options.minutes:
            output = Path(folder) / f"{len(samples)}.frog"
            limits = TrainingOptions(recipe="draft", seconds=options.each, scale=options.scale, seed=len(samples))
            request = TrainingRequest(options.capture, output, limits)
            frames = train(request, options.each)
            scene.render.engine = "FROG"
            bpy.ops.render.render()
            for path in Path(folder).glob(f"{len(samples) - 1}.*"):
                path.unlink()
            now = {"training": len(samples), "minutes": round((time.monotonic() - began) / 60, 2), "frames": frames}
            samples.append(now | held_now())
            print(json.dumps(samples[-1]), flush=True)
    print(json.dumps({"growth an hour": slopes(samples), "trainings": len(samples)}), flush=True)


if __name__ == "__main__":
    main()
