"""Times the deformation field, forward and backward: the native library's fused pass against plain torch.

    python benchmarks/deformation.py [--count 20000] [--threads 2] [--repeats 9]

One JSON line for each network (the recipes' shared hidden layer of 64, and the paper's five heads of 128) and each
implementation: medians in seconds, the arithmetic it needs (forward plus twice that backward) and its rate.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import torch

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.frog import FINISHED, Frog, FrogSettings
from frog_blender.engine.rasterizer import GaussianArrays, native

NETWORKS = {
    "shared 64": {"hidden_width": 64, "head_width": 0, "deformed_sh": 1},
    "five heads of 128": {"hidden_width": 128, "head_width": 128, "deformed_sh": 4},
}
OUTPUTS = ("means", "quaternions", "scales", "opacities", "sh")


def make(count: int, **settings: int) -> Frog:
    """A model of random Gaussians whose network puts something out."""
    torch.manual_seed(0)
    values = new_gaussians(torch.randn(count, 3), torch.rand(count, 3), torch.full((count,), 0.02), 4, 32)
    values["embeddings"] = 0.3 * torch.randn(count, 32)
    model = Frog(CanonicalField(values), FrogSettings(temporal_rows=15, coarse_rows=5, **settings))
    torch.nn.init.normal_(model.deformation.output_weight, std=0.1)
    return model


def multiplications(model: Frog) -> int:
    """Multiply-adds of the folded network's forward pass over all Gaussians."""
    network, s = model.deformation, model.settings
    weights = network.embedding_weight.numel() + network.output_weight.numel()
    if s.head_width:
        weights += network.head_weight.numel()
    return weights * len(model.canonical)


def timed(model: Frog, deform: Callable[[], GaussianArrays], repeats: int) -> tuple[float, float]:
    """Median seconds forward and backward."""
    forward, backward = [], []
    for _ in range(repeats + 2):
        model.zero_grad()
        started = time.perf_counter()
        gaussians = deform()
        forward.append(time.perf_counter() - started)
        outputs = [getattr(gaussians, name) for name in OUTPUTS]
        by = [torch.ones_like(output) for output in outputs]
        started = time.perf_counter()
        torch.autograd.backward(outputs, by)
        backward.append(time.perf_counter() - started)
    return statistics.median(forward[2:]), statistics.median(backward[2:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--threads", type=int, default=0, help="0: one for each core")
    parser.add_argument("--repeats", type=int, default=9)
    options = parser.parse_args()
    native.set_thread_count(options.threads)
    if options.threads:
        torch.set_num_threads(options.threads)
    for name, settings in NETWORKS.items():
        model = make(options.count, **settings)
        ways = {
            "native": lambda model=model: model.deform(0.37)[0],
            "torch": lambda model=model: model.deform_plainly(model.temporal_embedding(0.37), FINISHED, 4)[0],
        }
        flops = 6 * multiplications(model)
        for way, deform in ways.items():
            forward, backward = timed(model, deform, options.repeats)
            result = {"network": name, "count": options.count, "implementation": way, "threads": options.threads}
            result |= {
                "isa": native.instruction_set(),
                "forward_s": round(forward, 5),
                "backward_s": round(backward, 5),
            }
            result |= {"gflop": round(flops / 1e9, 2), "gflop_per_s": round(flops / 1e9 / (forward + backward), 1)}
            print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
