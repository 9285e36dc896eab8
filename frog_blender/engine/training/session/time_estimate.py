"""How long a training takes by the clock: a rough count of its work, times what earlier trainings took for theirs.

Nothing here needs torch, since a panel or a command line asks before torch is loaded.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ...capture.capture import Capture
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.cache_folder import default_cache_folder
from ...recipes import Recipe
from ...whole_progress import WholeProgress, about
from . import events
from .job import TrainingJob

_SHORT = 10.0  # reference seconds below which a training teaches nothing
_NEWEST = 0.5  # share of the newest training in a factor
# Reference seconds, on two cores with AVX2 at 3.2 GHz. Of a step: fixed, for a thousand Gaussians, for a thousand of
# them and a thousand weights of the network, and for a million pixels. Of an image's million pixels that are decoded.
_FIXED, _GAUSSIANS, _WEIGHTS, _PIXELS, _DECODED = 6e-3, 0.53e-3, 0.054e-3, 113e-3, 40e-3
_SEEDED = 0.5  # of an image's million pixels that seed points are sought in
_MOST_SEEDED = 200  # images
DECODING, SEEDING, TRAINING = "Decoding frames", "Finding seed points", "Training"
COMPRESSING, MEASURING, SAVING = "Compressing", "Measuring the quality", "Saving"
# Evaluations, compression and saving take as long as so many steps, by capacity.
_BESIDES = {
    "fixed": {TRAINING: 40, COMPRESSING: 0, MEASURING: 12, SAVING: 3},
    "auto": {TRAINING: 100, COMPRESSING: 70, MEASURING: 12, SAVING: 3},
}
_GPU = 0.1  # of a processor's time, until it is known


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
        spent = 1 - (1 - self._half) * r.half_size_until
        return (self.steps + sum(_BESIDES[r.capacity].values())) * sum(self._step) * spent

    @property
    def before(self) -> dict[str, float]:
        """Reference seconds of what comes before the training, by stage."""
        millions = self.pixels / 1e6
        seeding = _SEEDED * min(self.images, _MOST_SEEDED) * millions
        return {DECODING: _DECODED * self.images * millions, SEEDING: seeding}

    def spent(self, progress: float) -> float:
        """The share of its time that a training has taken until ``progress``: its first images may be smaller."""
        early = self.recipe.half_size_until
        return (progress - (1 - self._half) * min(progress, early)) / (1 - (1 - self._half) * early)

    @property
    def _step(self) -> tuple[float, float]:
        """Reference seconds of a step, by what depends on Gaussians and by what depends on pixels."""
        r = self.recipe
        weights = r.hidden_width * (r.embedding_size + 5 * r.head_width + 3 * (4 + r.deformed_sh))  # about
        cropped = 1 - r.region_share + r.region_share * r.region_size**2
        of_gaussians = (_GAUSSIANS + _WEIGHTS * weights / 1e3) * r.max_gaussians / 1e3
        return _FIXED + of_gaussians, _PIXELS * cropped * self.pixels / 1e6

    @property
    def _half(self) -> float:
        """Time of a step on images of half the size, over that of one on whole ones."""
        of_gaussians, of_pixels = self._step
        return (of_gaussians + of_pixels / 4) / (of_gaussians + of_pixels)


def estimate(work: Workload, device: str = "cpu", limit: float | None = None) -> str:
    """A sentence about the time for ``work`` on "cpu" or "cuda", or for a training of ``limit`` seconds."""
    trainings, factor = history(device)
    where = "on the GPU" if device == "cuda" else "on this processor"
    if device == "cuda" and not trainings:
        return f"Time {where}: not known before a first training has finished there"
    seconds = factor * sum(work.before.values()) + (limit or factor * work.seconds)
    known = "as earlier trainings went" if trainings else "a guess until a training has finished here"
    return f"{'About' if trainings else 'Roughly'} {about(seconds)} {where}, {known}"


class RunProgress:
    """Where a run is, from its first frame to its file: put into its events as they pass.

    Args:
        work: of the whole training.
        device: "cpu" or "cuda".
        now: seconds on a clock that stands still during pauses.
        limit: of the training, seconds.
        begins: the progress of a resumed training: its bar begins there.
    """

    def __init__(
        self, work: Workload, device: str, now: Callable[[], float], limit: float | None = None, begins: float = 0.0
    ) -> None:
        trainings, factor = history(device)
        factor *= _GPU if device == "cuda" and not trainings else 1.0
        besides = _BESIDES[work.recipe.capacity]
        step = factor * work.seconds / (work.steps + sum(besides.values()))
        after = {name: step * count for name, count in besides.items()}
        training = limit or step * work.steps + after[TRAINING]
        self._work, self._begins = work, work.spent(begins)
        plan = {name: factor * seconds for name, seconds in work.before.items()}
        plan |= after | {TRAINING: training * (1 - self._begins)}
        self._whole = WholeProgress(list(plan.items()), now, training * self._begins)

    def following(self, stream: Iterator[events.Event]) -> Iterator[events.Event]:
        """The events, of which those that tell progress tell that of the whole as well."""
        for event in stream:
            if isinstance(event, events.Stage):
                told = self._whole.tell(event.name, event.done / max(event.total, 1))
                yield replace(event, fraction=told.fraction, seconds_left=told.seconds_left)
            elif isinstance(event, events.Progress):
                spent = self._work.spent(event.step / max(event.steps, 1))
                told = self._whole.tell(TRAINING, (spent - self._begins) / max(1 - self._begins, 1e-9))
                yield replace(event, fraction=told.fraction, seconds_left=told.seconds_left)
            else:
                yield event


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
