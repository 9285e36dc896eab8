"""Times of a method on a quiet machine: a training step, the deformation in training, playback of a finished scene.

Each is a median over many frame times after a warm-up. No frame time occurs twice, because players cache recent ones.
On a GPU the clock is read after the device has finished.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from ..engine import Camera, ScenePlayer, draw, gc_frozen
from .results import Record

if TYPE_CHECKING:
    from ..engine import SceneModel, Session

NUM_TIMES, WARM_UP = 40, 5
"""Frame times that are measured, and those before them that are not."""
_GOLDEN = 0.6180339887498949


def spread_times(count: int, start: float = 0.5) -> list[float]:
    """``count`` different times in [0, 1), evenly spread and unordered (multiples of the golden ratio)."""
    return [(start + i * _GOLDEN) % 1.0 for i in range(count)]


def seconds_each(
    work: Callable[[float], object],
    times: Iterable[float],
    synchronize: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = perf_counter,
) -> list[float]:
    """Seconds that ``work(time)`` takes at each of the times.

    Args:
        synchronize: waits for the device.
        clock: seconds since any start.
    """
    result = []
    for time in times:
        synchronize()
        started = clock()
        work(time)
        synchronize()
        result.append(clock() - started)
    return result


def time_playback(scene: ScenePlayer, camera: Camera, count: int = NUM_TIMES) -> Record:
    """Playback on the CPU.

    "deformation_ms" is of ``scene.at``, "rasterization_ms" of ``draw``; "frame_ms" and "fps" are of both.

    Args:
        count: number of frame times; the milliseconds are medians over them.
    """
    background = scene.header.background
    deformation, rasterization = [], []
    for index, time in enumerate(spread_times(count + WARM_UP)):
        started = perf_counter()
        gaussians = scene.at(time)
        deformed = perf_counter()
        draw(gaussians, camera, background)
        ended = perf_counter()
        if index >= WARM_UP:
            deformation.append(deformed - started)
            rasterization.append(ended - deformed)
    frame = statistics.median(a + b for a, b in zip(deformation, rasterization, strict=True))
    return {
        "gaussians": scene.count,
        "size": [camera.width, camera.height],
        "deformation_ms": 1e3 * statistics.median(deformation),
        "rasterization_ms": 1e3 * statistics.median(rasterization),
        "frame_ms": 1e3 * frame,
        "fps": 1 / frame,
    }


def time_training_path(
    model: SceneModel, camera: Camera, background: Sequence[float], count: int = NUM_TIMES
) -> Record:
    """The deformation as a training step computes it, on the model's device.

    "forward_ms" and "forward_backward_ms" are of ``model.deform``. "frame_ms" and "fps" are of the forward pass and
    the rasterization of its Gaussians, without gradients.

    Args:
        background: RGB in [0, 1].
        count: number of frame times; the milliseconds are medians over them.
    """
    import torch

    from ..engine import rasterize, torch_threads

    device = model.canonical.means.device
    synchronize = torch.cuda.synchronize if device.type == "cuda" else lambda: None
    color = (float(background[0]), float(background[1]), float(background[2]))

    def forward(time: float) -> None:
        model.deform(time)

    def forward_backward(time: float) -> None:
        gaussians = model.deform(time)[0]
        outputs = [getattr(gaussians, name) for name in ("means", "quaternions", "scales", "opacities", "sh")]
        outputs = [output for output in outputs if output.requires_grad]
        torch.autograd.backward(outputs, [torch.ones_like(output) for output in outputs])
        model.zero_grad(set_to_none=True)

    def frame(time: float) -> None:
        with torch.no_grad():
            rasterize(model.deform(time)[0], camera, color)

    times = spread_times(count + WARM_UP)
    result: Record = {"gaussians": len(model.canonical), "device": device.type}
    with torch_threads(1):  # as a training step
        for name, work in (("forward", forward), ("forward_backward", forward_backward), ("frame", frame)):
            result[f"{name}_ms"] = 1e3 * statistics.median(seconds_each(work, times, synchronize)[WARM_UP:])
    result["fps"] = 1e3 / result["frame_ms"]
    return result


@dataclass
class StepTimes:
    """Seconds of training steps: of plain steps, and of steps that added, removed or reordered Gaussians."""

    plain: list[float] = field(default_factory=list)
    reindexing: list[float] = field(default_factory=list)

    def summary(self) -> Record:
        """The part of a record on steps.

        "steps" and "rounds" count all steps and the reindexing ones. "step_ms" (mean) and "step_median_ms" are of plain
        steps, "round_ms" is what a reindexing step takes in addition.
        """
        step = float(np.mean(self.plain)) if self.plain else float("nan")
        return {
            "steps": len(self.plain) + len(self.reindexing),
            "step_ms": 1e3 * step,
            "step_median_ms": 1e3 * statistics.median(self.plain) if self.plain else float("nan"),
            "rounds": len(self.reindexing),
            "round_ms": 1e3 * (float(np.mean(self.reindexing)) - step) if self.reindexing else 0.0,
        }

    def training_seconds(self, steps: int) -> float:
        """Duration of a training of ``steps`` steps; the number of reindexing steps does not depend on it."""
        found = self.summary()
        seconds: float = (steps * found["step_ms"] + found["rounds"] * found["round_ms"]) / 1e3
        return seconds


def time_steps(session: Session) -> StepTimes:
    """Trains a session to its end.

    Even a short training passes through every schedule, so that its mean step is that of a long one.
    """
    trainer, times = session.trainer, StepTimes()
    with gc_frozen():  # as in a training
        while not trainer.finished:
            count, graph = trainer.count, trainer.smoothness.graph
            before = trainer.seconds
            trainer.step()
            seconds = trainer.seconds - before
            if trainer.step_count <= WARM_UP:
                continue
            changed = trainer.count != count or trainer.smoothness.graph is not graph
            (times.reindexing if changed else times.plain).append(seconds)
    trainer.check()
    return times
