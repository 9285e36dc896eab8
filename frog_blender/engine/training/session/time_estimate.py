"""How long a training takes by the clock: a rough count of its work, times what earlier trainings took for theirs.

Nothing here needs torch, since a panel or a command line asks before torch is loaded.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ...capture.capture import Capture
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.cache_folder import default_cache_folder
from ...recipes import Recipe
from . import events
from .job import TrainingJob

_SHORT = 10.0  # reference seconds below which a training teaches nothing
_NEWEST = 0.5  # share of the newest training in a factor
# Reference seconds, on two cores with AVX2 at 3.2 GHz. Of a step: fixed, for a thousand Gaussians, for a thousand of
# them and a thousand weights of the network, and for a million pixels. Of an image's million pixels that are decoded.
_FIXED, _GAUSSIANS, _WEIGHTS, _PIXELS, _DECODED = 6e-3, 0.53e-3, 0.054e-3, 113e-3, 40e-3
# Evaluations, compression and saving take as long as so many steps, by capacity: before the last step, and after it.
_BESIDES = {"fixed": (40, 15), "auto": (140, 45)}
_HALF = 0.4  # time of a step on images of half the size


@dataclass(frozen=True)
class Workload:
    """What a training has to do.

    Attributes:
        recipe: its schedules, Gaussians and network.
        steps: of the whole training.
        pixels: of an image, in the mean.
        images: of the capture.
    """

    recipe: Recipe
    steps: int
    pixels: float
    images: int

    @classmethod
    def of(cls, capture: Capture, recipe: Recipe, steps: int | None = None, scale: float = 1.0) -> Workload:
        """For a capture at an image scale; ``steps`` None for the recipe's own."""
        pixels = sum(camera.width * camera.height for camera in capture.cameras) / len(capture.cameras)
        return cls(recipe, steps or recipe.steps_for(capture.frame_count), pixels * scale**2, len(capture.shots))

    @property
    def seconds(self) -> float:
        """Of the training on the reference computer."""
        r = self.recipe
        weights = r.hidden_width * (r.embedding_size + 5 * r.head_width + 3 * (4 + r.deformed_sh))  # about
        cropped = 1 - r.region_share + r.region_share * r.region_size**2
        of_gaussians = (_GAUSSIANS + _WEIGHTS * weights / 1e3) * r.max_gaussians / 1e3
        step = _FIXED + of_gaussians + _PIXELS * cropped * self.pixels / 1e6
        return (self.steps + sum(_BESIDES[r.capacity])) * step * r.views_per_step * _spent(r, 1.0)


def _spent(recipe: Recipe, progress: float) -> float:
    """What a training has taken until ``progress``, over what it would take with whole images only."""
    return progress - (1 - _HALF) * min(progress, recipe.half_size_until)


def estimate(work: Workload, device: str = "cpu", limit: float | None = None) -> str:
    """A sentence about the time for ``work`` on "cpu" or "cuda", or for a training of ``limit`` seconds."""
    trainings, factor = history(device)
    where = "on the GPU" if device == "cuda" else "on this processor"
    if device == "cuda" and not trainings:
        return f"Time {where}: not known before a first training has finished there"
    seconds = factor * _DECODED * work.images * work.pixels / 1e6 + (limit or factor * work.seconds)
    known = "as earlier trainings went" if trainings else "a guess until a training has finished here"
    return f"{'About' if trainings else 'Roughly'} {about(seconds)} {where}, {known}"


class TimeLeft:
    """What is left of a training by the clock, at a moving average of the pace of its last tenth.

    Args:
        work: of the whole training.
        device: "cpu" or "cuda".
        progress: of the training, at ``seconds`` of a clock.
    """

    def __init__(self, work: Workload, device: str, progress: float, seconds: float) -> None:
        self._recipe, after = work.recipe, _BESIDES[work.recipe.capacity][1]
        self._whole = _spent(work.recipe, 1.0) * (1 + after / work.steps)
        self._rate = history(device)[1] * work.seconds / self._whole
        self._spent, self._seconds = _spent(work.recipe, progress), seconds

    def at(self, progress: float, seconds: float) -> float:
        """Seconds left at ``progress``, to which the training came at ``seconds`` of the clock."""
        passed, took = _spent(self._recipe, progress) - self._spent, seconds - self._seconds
        self._spent, self._seconds = self._spent + passed, seconds
        if passed > 0:  # after a rollback there is nothing to learn
            self._rate += min(1.0, 10 * passed / self._whole) * (took / passed - self._rate)
        return (self._whole - self._spent) * self._rate


def remembering(stream: Iterator[events.Event], job: TrainingJob) -> Iterator[events.Event]:
    """A job's events as they are; how long it took is remembered when it has finished.

    A training that is limited by time, is resumed, is short or is of another method teaches nothing.
    """
    started: events.Started | None = None
    for event in stream:
        if isinstance(event, events.Started) and event.steps and job.method == "frog" and not job.resume:
            started = event
        elif isinstance(event, events.Finished) and started and started.steps:
            work = Workload(job.recipe, started.steps, started.pixels, started.images)
            took = event.phases.get("training", 0.0) + event.phases.get("finishing", 0.0)
            if work.seconds >= _SHORT and took > 0:
                _remember(started.device, took / work.seconds)
        yield event


def history(device: str) -> tuple[int, float]:
    """How many trainings were remembered, and how many times the reference's seconds they took; else a guess."""
    with suppress(OSError, ValueError, RecursionError, TypeError, KeyError):
        entry = json.loads(_file(device).read_text(encoding="utf-8"))
        trainings, factor = int(entry["trainings"]), float(entry["factor"])
        if trainings > 0 and 0 < factor < 1e9:
            return trainings, factor
    return 0, (2 / (os.cpu_count() or 2)) ** 0.7


def _remember(device: str, factor: float) -> None:
    """A disk that does not accept it changes nothing."""
    trainings, before = history(device)
    newest = _NEWEST if trainings else 1.0
    entry = {"trainings": trainings + 1, "factor": newest * factor + (1 - newest) * before}
    with suppress(FrogError, OSError):
        write_atomically(_file(device), json.dumps(entry).encode())


def _file(device: str) -> Path:
    """Beside the decoded frames: it belongs to this computer and its user."""
    return default_cache_folder() / f"training_times_{device}.json"


def about(seconds: float) -> str:
    """No more precisely than an estimate is: 48 -> "50 seconds", 250 -> "4 minutes", 9000 -> "2.5 hours"."""
    if seconds < 95:
        return f"{max(10, round(seconds, -1)):.0f} seconds"
    if seconds < 95 * 60:
        minutes = seconds / 60
        return f"{round(minutes) if minutes < 20 else 5 * round(minutes / 5)} minutes"
    return f"{seconds / 3600:.1f}".removesuffix(".0") + " hours"


def likely_device(name: str) -> str:
    """What ``choose_device`` will make of a name, without loading torch: "auto" is a GPU where there is a driver."""
    if name != "auto":
        return name
    if torch := sys.modules.get("torch"):
        return "cuda" if torch.cuda.is_available() else "cpu"
    return "cuda" if has_nvidia_gpu() else "cpu"


def has_nvidia_gpu() -> bool:
    """Whether this computer has a driver of NVIDIA's, by the files that it brings: to Linux, WSL or Windows."""
    system = Path(os.environ.get("SYSTEMROOT", "C:/Windows")) / "System32" / "nvcuda.dll"
    drivers = Path("/proc/driver/nvidia/version"), Path("/usr/lib/wsl/lib/libcuda.so.1"), system
    return any(driver.exists() for driver in drivers)
