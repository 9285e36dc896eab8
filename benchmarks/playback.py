"""What a frame's deformation takes in scenes, beside each other: what automatic capacity saves at playback.

    python benchmarks/playback.py FIXED.frog AUTO.frog... [--threads 2] [--repeats 200]

One JSON object a scene: Gaussians, how many move, the network's units, the median milliseconds of a time that is not
remembered, and how many times as long the first scene takes. Scenes take turns, so that what else the machine does
meets all of them alike.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

from frog_blender.engine.native import binding
from frog_blender.engine.playback.player import ScenePlayer


def main() -> None:
    parser = argparse.ArgumentParser(prog="playback.py", description="What a frame's deformation takes.")
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=200)
    options = parser.parse_args()
    binding.set_thread_count(options.threads)
    scenes = [ScenePlayer.load(path) for path in options.scenes]
    for path, scene in zip(options.scenes, scenes, strict=True):
        if not scene.num_dynamic:
            parser.error(f"{path}: nothing moves there, expected a scene with a deformation to be timed")
    seconds: list[list[float]] = [[] for _ in scenes]
    for turn in range(-5, options.repeats):  # five to warm up
        for scene, taken in zip(scenes, seconds, strict=True):
            frame_time = (0.6180339887498949 * (turn + 5)) % 1.0  # never one of those that a scene remembers
            began = time.perf_counter()
            scene.at(frame_time)
            if turn >= 0:
                taken.append(time.perf_counter() - began)
    medians = [1e3 * statistics.median(taken) for taken in seconds]
    for path, scene, median in zip(options.scenes, scenes, medians, strict=True):
        found = {"scene": path.name, "gaussians": scene.count, "moving": scene.num_dynamic}
        found |= {"units": scene.header.model.get("hidden_width", 0), "milliseconds": round(median, 3)}
        print(json.dumps(found | {"first over this": round(medians[0] / median, 2)}))


if __name__ == "__main__":
    main()
