"""Times of a method on a quiet machine: a training step, the deformation in training, and a finished scene played.

Everything is a median over many moments, no moment twice (players keep the last ones), after a warm-up; on a GPU the
clock is read when the device has done its work.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..engine.capture.camera import Camera
from ..engine.memory import gc_frozen
from ..engine.playback.player import ScenePlayer
from ..engine.playback.render import draw

MOMENTS, WARM_UP = 40, 5
_GOLDEN = 0.6180339887498949


def moments(count: int, start: float = 0.5) -> list[float]:
    """``count`` different times in [0, 1), spread evenly and in no order (multiples of the golden ratio)."""
    return [(start + i * _GOLDEN) % 1.0 for i in range(count)]


def seconds_each(
    work: Callable[[float], Any], times: Iterable[float], synchronize: Callable[[], None] = lambda: None
) -> list[float]:
    """How long ``work(time)`` takes at each of the times; ``synchronize`` waits for a device."""
    result = []
    for moment in times:
        synchronize()
        started = time.perf_counter()
        work(moment)
        synchronize()
        result.append(time.perf_counter() - started)
    return result


def time_playback(scene: ScenePlayer, camera: Camera, count: int | None = None) -> dict[str, Any]:
    """Milliseconds a frame of ``deformation`` (``scene.at``), ``rasterization`` (``draw``) and both (``frame``), as
    medians, and ``fps`` of both: the inference engine on the CPU."""
    background = scene.header.background
    deformation, rasterization = [], []
    for number, moment in enumerate(moments((count or MOMENTS) + WARM_UP)):
        started = time.perf_counter()
        gaussians = scene.at(moment)
        deformed = time.perf_counter()
        draw(gaussians, camera, background)
        ended = time.perf_counter()
        if number >= WARM_UP:
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
    model: Any, camera: Camera, background: Sequence[float], count: int | None = None
) -> dict[str, Any]:
    """Milliseconds of ``model.deform`` as a training step calls it, ``forward`` alone and ``forward_backward``, and of
    drawing its Gaussians without gradients (``rasterization``), on the model's device.

    Args:
        model: a ``SceneModel``.
    """
    import torch

    from ..engine.rasterizer import rasterize
    from ..engine.training.optimize.device import torch_threads

    device = model.canonical.means.device
    synchronize = torch.cuda.synchronize if device.type == "cuda" else lambda: None
    color = (float(background[0]), float(background[1]), float(background[2]))

    def forward(moment: float) -> None:
        model.deform(moment)

    def forward_backward(moment: float) -> None:
        gaussians = model.deform(moment)[0]
        outputs = [getattr(gaussians, name) for name in ("means", "quaternions", "scales", "opacities", "sh")]
        outputs = [output for output in outputs if output.requires_grad]
        torch.autograd.backward(outputs, [torch.ones_like(output) for output in outputs])
        model.zero_grad(set_to_none=True)

    def both(moment: float) -> None:
        with torch.no_grad():
            rasterize(model.deform(moment)[0], camera, color)

    times = moments((count or MOMENTS) + WARM_UP)
    result: dict[str, Any] = {"gaussians": len(model.canonical), "device": device.type}
    with torch_threads(1):  # as a training step
        for name, work in (("forward", forward), ("forward_backward", forward_backward), ("frame", both)):
            result[f"{name}_ms"] = 1e3 * statistics.median(seconds_each(work, times, synchronize)[WARM_UP:])
    result["fps"] = 1e3 / result["frame_ms"]
    return result


@dataclass
class StepTimes:
    """Seconds of training steps: those of plain steps, and of steps at which Gaussians came or went."""

    plain: list[float] = field(default_factory=list)
    rounds: list[float] = field(default_factory=list)

    def summary(self) -> dict[str, Any]:
        """``step_ms`` and ``step_median_ms`` of plain steps, ``round_ms`` that a round adds; ``rounds``, ``steps``."""
        step = float(np.mean(self.plain)) if self.plain else float("nan")
        return {
            "steps": len(self.plain) + len(self.rounds),
            "step_ms": 1e3 * step,
            "step_median_ms": 1e3 * statistics.median(self.plain) if self.plain else float("nan"),
            "rounds": len(self.rounds),
            "round_ms": 1e3 * (float(np.mean(self.rounds)) - step) if self.rounds else 0.0,
        }

    def training_seconds(self, steps: int) -> float:
        """What a training of so many steps takes: the number of rounds does not depend on it."""
        found = self.summary()
        return (steps * found["step_ms"] + found["rounds"] * found["round_ms"]) / 1e3


def time_steps(trainer: Any) -> StepTimes:
    """Takes a ``Trainer`` to its end. A short training passes through every schedule, growth included, so its mean step
    is a long one's."""
    times = StepTimes()
    with gc_frozen():  # as in a training
        while not trainer.finished:
            count, graph = trainer.count, trainer.smoothness.graph
            before = trainer.seconds
            trainer.step()
            seconds = trainer.seconds - before
            if trainer.step_count <= WARM_UP:
                continue
            changed = trainer.count != count or trainer.smoothness.graph is not graph
            (times.rounds if changed else times.plain).append(seconds)
    trainer.check()
    return times
