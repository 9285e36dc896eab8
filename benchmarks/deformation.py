"""Times the deformation field: the training path (forward, and forward with backward) and the inference engine.

    python benchmarks/deformation.py [--counts 20000 200000] [--threads 2] [--repeats 15] [--cold]

One JSON line for each network (the recipes' shared hidden layer of 64, with modulation and without, the paper's five
heads of 128; one network as in FRoG, two as in E-D3DGS), number of Gaussians and path: seconds (median and best), and
what they cannot be less than: the arithmetic at the machine's measured peak, and the bytes that must be moved at its
measured bandwidth (which binds only what is larger than the caches). The paths of a network take turns, so that they
find little of their own in the caches, and so do one network and two after a few times each, so that what else the
machine does meets all of them alike. With ``--cold`` none of them finds anything in the caches, as in a training, whose
steps touch as much, and in a video whose every frame is drawn: each core writes 64 MB before.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import statistics
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import bandwidth
import numpy as np
import peak
import torch

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.fused import FieldPass, field_arrays, forward_field
from frog_blender.engine.model.interface import FINISHED
from frog_blender.engine.native import binding
from frog_blender.engine.playback.deformation import DeformationPlayer
from frog_blender.research.timing import spread_times

NETWORKS: dict[str, dict[str, Any]] = {
    "shared 64": {"hidden_width": 64, "head_width": 0, "deformed_sh": 1},
    "shared 64, modulated": {"hidden_width": 64, "head_width": 0, "deformed_sh": 1, "modulation": True},
    "five heads of 128": {"hidden_width": 128, "head_width": 128, "deformed_sh": 4},
}
FUSIONS = {1: "product", 2: "dual"}
OUTPUTS = ("means", "quaternions", "scales", "opacities", "sh")
EMBEDDING, SH_COUNT = 32, 4
_DISPLACING = 1 << 24  # floats, 64 MB
_ROUND, _WARM_UP = 5, 2  # times
_LONGEST = 20.0  # seconds that one network and number of Gaussians may take beyond a round
Way = tuple[str, int]
"""A path, and of how many networks."""


def make(count: int, **settings: Any) -> Frog:
    """A model of random Gaussians whose network puts something out."""
    torch.manual_seed(0)
    points, colors, sizes = torch.randn(count, 3), torch.rand(count, 3), torch.full((count,), 0.02)
    values = new_gaussians(points, colors, sizes, SH_COUNT, EMBEDDING)
    values["embeddings"] = 0.3 * torch.randn(count, EMBEDDING)
    model = Frog(CanonicalField(values), FrogSettings(temporal_rows=15, coarse_rows=5, **settings))
    torch.nn.init.normal_(model.deformation.output_weight, std=0.1)
    return model


def player(model: Frog) -> DeformationPlayer:
    """The inference engine's view of the same scene."""
    arrays = {}
    for name, value in model.state_dict().items():
        arrays[name.removeprefix("canonical.").replace("deformation.", "network.")] = value.numpy()
    return DeformationPlayer(arrays, model.stored_settings(FINISHED))


def paths_of(model: Frog) -> dict[str, Callable[[float], object]]:
    """What is timed, by name, each at a time in [0, 1]: training as a step on the CPU has it (model.fused_drawing)."""
    played, shape = player(model), model.field_shape(FINISHED)
    like = vars(model.deform(0.5)[0])
    by_outputs = {name: torch.ones_like(like[name]) for name in OUTPUTS}  # in a step the rasterizer's

    def forward(time: float) -> tuple[dict[str, torch.Tensor], FieldPass]:
        arrays = field_arrays(model.canonical, model.deformation, temporal=model.temporal_embedding(time))
        return arrays, forward_field(shape, arrays)[0]

    def both_ways(time: float) -> dict[str, torch.Tensor]:
        arrays, field = forward(time)
        gradients = field.backward(by_outputs)
        arrays["temporal"].backward(gradients.pop("temporal"))
        return gradients

    return {"training, forward": forward, "training, forward and backward": both_ways, "inference": played.at}


def work_of(model: Frog, path: str) -> tuple[float, float]:
    """(operations, bytes) that cannot be avoided: a multiply-add is two operations, every array is moved once, and the
    backward pass takes twice the forward's arithmetic."""
    network, s, count = model.deformation, model.settings, len(model.canonical)
    first, output = network.embedding_weight.numel(), network.output_weight.numel()
    heads = network.head_weight.numel() if s.head_width else 0
    canonical, deformed = 11 + 3 * SH_COUNT, network.output_bias.numel()
    kept = path == "inference" and not s.head_width and not s.modulation
    products = first * (not kept) + heads + output
    floats = len(network.embedding_weight) if kept else EMBEDDING
    floats += 2 * deformed if path == "inference" else 2 * canonical + deformed  # read and write; the changes too
    if "backward" in path:
        products *= 3
        floats += 2 * (EMBEDDING + canonical) + canonical  # read again with gradients, and gradients written
    return 2.0 * products * count, 4.0 * floats * count


def displace(memory: np.ndarray) -> None:
    """A thread for each row of ``memory`` writes all of it."""
    threads = [threading.Thread(target=np.add, args=(row, 1, row)) for row in memory]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def timed(
    paths: dict[Way, Callable[[float], object]], times: Sequence[float], displacing: np.ndarray | None = None
) -> dict[Way, list[float]]:
    """Seconds of each path at each of the times but the first few, which warm up; ``displacing`` (threads, N) takes the
    caches of as many cores before each."""
    seconds: dict[Way, list[float]] = {way: [] for way in paths}
    for frame_time in times:
        for way, run in paths.items():
            if displacing is not None:
                displace(displacing)
            started = time.perf_counter()
            result = run(frame_time)
            seconds[way].append(time.perf_counter() - started)
            del result
    return {way: taken[_WARM_UP:] for way, taken in seconds.items()}


def in_rounds(
    groups: list[dict[Way, Callable[[float], object]]], repeats: int, displacing: np.ndarray | None = None
) -> dict[Way, list[float]]:
    """The same at ``repeats`` times, none twice, a few of each group of paths in turn; fewer where that takes
    long."""
    seconds: dict[Way, list[float]] = {way: [] for group in groups for way in group}
    began = time.perf_counter()
    times = iter(spread_times(repeats + _WARM_UP * math.ceil(repeats / _ROUND)))
    while some := list(itertools.islice(times, _WARM_UP + _ROUND)):
        for group in groups:
            for way, taken in timed(group, some, displacing).items():
                seconds[way] += taken
        if time.perf_counter() - began > _LONGEST:
            break
    return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 200_000])
    parser.add_argument("--threads", type=int, default=0, help="0: one for each core")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--cold", action="store_true", help="nothing is in the caches")
    options = parser.parse_args()
    binding.set_thread_count(options.threads)
    torch.set_num_threads(1)  # as in a training step
    threads, core = options.threads or os.cpu_count() or 1, peak.measure()
    gigabytes = bandwidth.measure(threads)
    displacing = np.zeros((threads, _DISPLACING), np.float32) if options.cold else None
    for count in options.counts:
        for name, settings in NETWORKS.items():
            models = {networks: make(count, fusion=fusion, **settings) for networks, fusion in FUSIONS.items()}
            groups = [{(path, k): run for path, run in paths_of(model).items()} for k, model in models.items()]
            for (path, networks), seconds in in_rounds(groups, options.repeats, displacing).items():
                operations, moved = work_of(models[networks], path)
                result: dict[str, Any] = {"network": name, "networks": networks, "count": count, "path": path}
                result |= {"threads": threads, "isa": binding.instruction_set()}
                result |= {"cold": options.cold}
                result |= {"seconds": statistics.median(seconds), "best": min(seconds)}
                result |= {"arithmetic_bound": operations / (1e9 * core.gflops * threads) if core else None}
                result |= {"memory_bound": moved / (1e9 * gigabytes)}
                result |= {"gflop": operations / 1e9, "megabytes": moved / 1e6, "gigabytes_per_s": gigabytes}
                rounded = {k: round(v, 6) if isinstance(v, float) else v for k, v in result.items()}
                print(json.dumps(rounded), flush=True)


if __name__ == "__main__":
    main()
