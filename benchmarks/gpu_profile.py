"""Which kernels a usual training step runs on a GPU, how many, for how long, and where the GPU waits for the host.

    python benchmarks/gpu_profile.py [--capture DIR] [--counts 20000 300000] [--ways ours before] [--steps 20]
                                     [--scene 100k_b] [--kernels 40] [--device cuda]

One JSON object a run: figures of a step (means over ``--steps``), and under "kernels" the longest kernels with their
number and microseconds a step. torch.profiler records everything that the device does, whoever launched it. Profiled
steps are slower for the host, so the step's own time is taken before, without the profiler.

Waits are calls in which the host waits for the device. One costs nothing while the device has work queued behind what
is waited for; it idles the GPU where the device has nothing to do when the wait ends.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import gpu_step
import torch

from frog_blender.engine.recipes import recipe

ON_DEVICE = {"kernel": "kernels", "gpu_memcpy": "copies", "gpu_memset": "fills"}
HOST_CALLS = ("cuda_runtime", "cuda_driver")
WAITS = ("Synchronize", "cudaMemcpy", "cuMemcpy", "cudaMalloc", "cudaFree", "cuMemAlloc", "cuMemFree")
NO_WAITS = ("Async", "cudaMallocHost", "cudaFreeHost", "StreamWaitEvent")
STEPS = "the steps"  # what the trace calls the time from the first to the last
LEAST_GAP = 2.0  # microseconds without work that count as idling: kernels in a row leave less between them

Span = tuple[float, float]
"""From and to, microseconds."""


def summary(events: Iterable[dict[str, Any]], steps: int, most_kernels: int) -> dict[str, Any]:
    """Figures a step from a trace in Chrome's format of ``steps`` steps; waits before and after STEPS do not count."""
    events = [event for event in events if event.get("ph") == "X"]
    begun, ended = next((span_of(event) for event in events if event.get("name") == STEPS), (-math.inf, math.inf))
    found: defaultdict[str, float] = defaultdict(float)
    kernels: defaultdict[str, list[float]] = defaultdict(list)
    waits: defaultdict[str, list[Span]] = defaultdict(list)
    device: list[Span] = []
    for event in events:
        category, name, span = event.get("cat"), str(event.get("name")), span_of(event)
        if category in ON_DEVICE:
            device.append(span)
            found[ON_DEVICE[category]] += 1 / steps
            if category == "kernel":
                kernels[name].append(span[1] - span[0])
        elif not begun <= span[0] <= ended:
            continue
        elif category in HOST_CALLS and any(w in name for w in WAITS) and not any(w in name for w in NO_WAITS):
            waits[name].append(span)
        elif category == "cpu_op" and name == "aten::_local_scalar_dense":
            found["items"] += 1 / steps
    busy = merged(device)
    gaps = [(one[1], two[0]) for one, two in pairwise(busy) if two[0] - one[1] > LEAST_GAP]
    all_waits = [span for spans in waits.values() for span in spans]
    idle = [gap for gap in gaps if any(gap[0] <= end <= gap[1] for _, end in all_waits)]
    found["device_us"] = sum(end - start for start, end in busy) / steps
    found["waits"] = len(all_waits) / steps
    found["waits_that_idle"] = len(idle) / steps
    found["idle_after_waits_us"] = sum(end - start for start, end in idle) / steps
    names = ("kernels", "copies", "fills", "device_us", "waits", "waits_that_idle", "idle_after_waits_us", "items")
    longest = sorted(kernels.items(), key=lambda item: -sum(item[1]))[:most_kernels]
    return {
        **{name: round(found[name], 2) for name in names},
        "waits_by_call": {name: round(len(spans) / steps, 2) for name, spans in waits.items()},
        "kernels_by_name": [
            {"kernel": name[:90], "a_step": round(len(spent) / steps, 2), "us": round(sum(spent) / steps, 1)}
            for name, spent in longest
        ],
    }


def span_of(event: dict[str, Any]) -> Span:
    """When an event of a trace began and ended."""
    return float(event["ts"]), float(event["ts"]) + float(event["dur"])


def merged(spans: list[Span]) -> list[Span]:
    """The spans in order, those that touch or overlap as one."""
    joined: list[Span] = []
    for start, end in sorted(spans):
        if joined and start <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(end, joined[-1][1])
        else:
            joined.append((start, end))
    return joined


def profiled(trainer: Any, steps: int, device: str) -> list[dict[str, Any]]:
    """The trace's events of so many steps."""
    activities = [torch.profiler.ProfilerActivity.CPU]
    if device == "cuda":
        activities.append(torch.profiler.ProfilerActivity.CUDA)
        with torch.profiler.profile(activities=activities):  # the first one loads the tracer, and may miss something
            trainer.step()
            torch.cuda.synchronize()
    with torch.profiler.profile(activities=activities) as profile:
        with torch.profiler.record_function(STEPS):
            for _ in range(steps):
                trainer.step()
        if device == "cuda":
            torch.cuda.synchronize()
    with tempfile.TemporaryDirectory(prefix="frog-profile-") as folder:
        path = Path(folder) / "trace.json"
        profile.export_chrome_trace(str(path))
        events: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["traceEvents"]
    return events


def measure(material: gpu_step.Material, way: str, options: argparse.Namespace) -> dict[str, Any]:
    """One run's record."""
    with gpu_step.of_torch_alone(way):
        trainer = gpu_step.settled_trainer(material, way, recipe("standard").region_share, options.device)
        step_ms = gpu_step.timed(trainer, options.steps, options.device)["back_to_back_ms"]
        events = profiled(trainer, options.steps, options.device)
    figures = summary(events, options.steps, options.kernels)
    share = round(figures["device_us"] / (1e3 * step_ms), 3)
    return {"gaussians": len(material.seeds.points), "way": way, "step_ms": step_ms, "busy_share": share, **figures}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--scale", type=float)
    parser.add_argument("--scene", default="100k_b", help="the generated scene where there is no capture")
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 300_000])
    parser.add_argument("--ways", nargs="+", choices=gpu_step.WAYS, default=["ours", "before"])
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--kernels", type=int, default=40, help="the longest that are listed")
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda")
    options = parser.parse_args()
    if options.capture:
        material = gpu_step.filmed(options.capture, options.scale)
    else:
        material = gpu_step.generated(options.scene, options.device)
    failed = False
    for way in options.ways:
        for count in options.counts:
            try:
                record = measure(material.resampled(count), way, options)
            except Exception as error:
                record = {"gaussians": count, "way": way, "failed": f"{type(error).__name__}: {error}"}
                failed = True
            print(json.dumps(record), flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
