"""How long a training takes by the clock, from decoding to the scene's file.

A rough model of the work gives seconds by phase on a reference computer. A factor by phase, kept from earlier trainings
on this computer, makes them this computer's, and what passes corrects what is left. Nothing here needs torch, since a
panel or a command line asks before torch is loaded.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.cache_folder import default_cache_folder
from ...native import binding
from ..recipe import Recipe
from . import events
from .cancel_token import CancelToken
from .job import TrainingJob

PHASES = ("decoding", "seeding", "training", "finishing")
MODEL = 3  # raise it when the model changes: older factors no longer fit then

_FILE = "training_times.json"  # beside the decoded frames: it belongs to this computer and its user
_GRID = np.linspace(0.0, 1.0, 401)  # of a training's progress, over which the cost of steps is summed
_SHORT = 10.0  # modelled seconds below which a training teaches nothing: what happens once outweighs its steps
_NEWEST = 0.5  # share of the newest training in a factor
_SKIPPED = 0.3  # of the expected time: decoding or seeding that is quicker found its results on disk
_FORGETTING = 10.0  # a tenth of a training replaces most of the rate that was measured before it

# Reference seconds, on two cores with AVX2 at 3.2 GHz. Of a step: fixed, for a thousand Gaussians, for a thousand of
# them and a thousand weights of the network, and for a million pixels rendered. Of decoding: for an image, and for a
# million pixels. Of the seed search, whose images are few and small.
_FIXED, _GAUSSIANS, _WEIGHTS, _PIXELS = 6e-3, 0.53e-3, 0.054e-3, 113e-3
_IMAGE, _DECODED, _SEEDING = 2e-3, 40e-3, 20.0
_QUICKER = {"avx512": 0.64}  # seconds for one of the reference's, by the instruction set
# What takes as long as so many steps: evaluations, previews and compression during the training, and evaluation,
# compression and saving after it; with a capacity of "fixed" or "auto".
_BESIDES, _FINISHING = {"fixed": 40, "auto": 140}, {"fixed": 15, "auto": 45}


@dataclass(frozen=True)
class Workload:
    """What a training has to do.

    Attributes:
        recipe: its schedules, Gaussians and network.
        steps: of the whole training.
        pixels: of an image, in the mean.
        images: of the capture, all of which are decoded first.
        even: True where every share of the progress takes as long: in a training that is limited by time.
    """

    recipe: Recipe
    steps: int
    pixels: float
    images: int = 0
    even: bool = False

    @classmethod
    def of(cls, capture: Capture, recipe: Recipe, steps: int | None = None, scale: float = 1.0) -> Workload:
        """For a capture at an image scale; ``steps`` None for the recipe's own."""
        pixels = float(np.mean([camera.width * camera.height for camera in capture.cameras])) * scale**2
        return cls(recipe, steps or recipe.steps_for(capture.frame_count), pixels, len(capture.shots))

    @cached_property
    def seconds(self) -> dict[str, float]:
        """Reference seconds of each phase."""
        capacity, training = self.recipe.capacity, float(self._cost[-1])
        decoding = self.images * (_IMAGE + _DECODED * self.pixels / 1e6)
        finishing = training * _FINISHING[capacity] / (self.steps + _BESIDES[capacity])
        return {"decoding": decoding, "seeding": _SEEDING, "training": training, "finishing": finishing}

    def training_until(self, progress: float) -> float:
        """Reference seconds of training before ``progress`` (0 to 1)."""
        return progress * self.seconds["training"] if self.even else float(np.interp(progress, _GRID, self._cost))

    @cached_property
    def _cost(self) -> NDArray[np.float64]:
        """Reference seconds from the start to each of _GRID."""
        r = self.recipe
        growing = np.clip(_GRID, r.densify_from, r.densify_until) - r.densify_from
        grown = r.seed_gaussians * (1 + r.densify_growth) ** (growing / r.densify_every)
        gaussians = np.minimum(grown, [r.growth_limit_at(progress) for progress in _GRID])
        cropped = (1 - r.region_share) + r.region_share * r.region_size**2
        pixels = self.pixels * np.where(r.half_size_until > _GRID, 0.25, cropped)
        weights = r.hidden_width * (r.embedding_size + 5 * r.head_width + 3 * (4 + r.deformed_sh))  # about
        step = _FIXED + (_GAUSSIANS + _WEIGHTS * weights / 1e3) * gaussians / 1e3 + _PIXELS * pixels / 1e6
        step *= r.views_per_step
        return (self.steps + _BESIDES[r.capacity]) * np.cumsum(step) / len(step)


@dataclass(frozen=True)
class Estimate:
    """How long a training will take.

    Attributes:
        seconds: by the clock; None where nothing is known, on a GPU that nothing was trained on.
        device: "cpu" or "cuda".
        trainings: finished ones on this computer and device that it rests on; with none it is a rough guess.
    """

    seconds: float | None
    device: str
    trainings: int

    def __str__(self) -> str:
        where = "on the GPU" if self.device == "cuda" else "on this processor"
        if self.seconds is None:
            return f"Time {where}: not known before a first training has finished there"
        if not self.trainings:
            return f"Roughly {about(self.seconds)} {where}, a guess until a training has finished here"
        return f"About {about(self.seconds)} {where}, as earlier trainings went"


def estimate(work: Workload, device: str = "cpu", *, prepared: bool = False, limit: float | None = None) -> Estimate:
    """The time for all phases of ``work`` on "cpu" or "cuda".

    Args:
        prepared: without the first two, where an earlier training has left frames and seed points on disk.
        limit: seconds that the training phase takes, whatever it has to do; None for as long as it needs.
    """
    trainings, factors = history(device)
    expected = {phase: work.seconds[phase] * factors[phase] for phase in PHASES[2 if prepared else 0 :]}
    if limit is not None:
        expected["training"] = limit
    return Estimate(sum(expected.values()) if device == "cpu" or trainings else None, device, trainings)


class TimeLeft:
    """What is left of a training by the clock: the estimate, corrected by a moving average of what passed.

    Args:
        work: of the whole training.
        device: "cpu" or "cuda".
        progress: of the training, at ``seconds`` of a clock.
    """

    def __init__(self, work: Workload, device: str, progress: float, seconds: float) -> None:
        self._work, self._factors = work, history(device)[1]
        self._rate, self._done, self._seconds = self._factors["training"], work.training_until(progress), seconds

    def at(self, progress: float, seconds: float) -> float:
        """Seconds left at ``progress``, to which the training came at ``seconds`` of the clock."""
        done, whole = self._work.training_until(progress), self._work.seconds["training"]
        passed, took = done - self._done, seconds - self._seconds
        self._done, self._seconds = done, seconds
        if passed > 0:  # after a rollback there is nothing to learn
            newest = 1 - (1 - min(1.0, passed / whole)) ** _FORGETTING
            self._rate += newest * (took / passed - self._rate)
        finishing = self._work.seconds["finishing"] * self._factors["finishing"]
        return (whole - done) * self._rate + finishing * self._rate / self._factors["training"]


def remembering(stream: Iterator[events.Event], job: TrainingJob) -> Iterator[events.Event]:
    """A job's events as they are; how long its phases took is remembered when it has finished.

    A training that is limited by time, is resumed, or is of another method teaches nothing.
    """
    started: events.Started | None = None
    for event in stream:
        if isinstance(event, events.Started) and event.steps and job.method == "frog" and not job.resume:
            started = event
        elif isinstance(event, events.Finished) and started and started.steps:
            remember(Workload(job.recipe, started.steps, started.pixels, started.images), started.device, event.phases)
        yield event


def history(device: str) -> tuple[int, dict[str, float]]:
    """How many trainings were remembered, and the factor of each phase; where there is none, a guess."""
    entries = _stored().get(device, {}).items()
    known = {name: value for name, value in entries if isinstance(value, int | float) and 0 < value < 1e9}
    # The reference has two cores; what more of them give is not measured.
    guess = (2 / (os.cpu_count() or 2)) ** 0.7 * _QUICKER.get(_instruction_set(), 1.0)
    return int(known.get("trainings", 0)), {phase: float(known.get(phase, guess)) for phase in PHASES}


def _instruction_set() -> str:
    """Of the processor, as far as the native library uses it; "" where there is no library."""
    with suppress(FrogError):
        return binding.instruction_set()
    return ""


def remember(work: Workload, device: str, phases: Mapping[str, float]) -> None:
    """Takes the seconds that each phase took into the factors; a disk that does not accept them changes nothing."""
    (trainings, factors), teaches = history(device), work.seconds["training"] >= _SHORT
    for phase, seconds in phases.items():
        ratio = seconds / work.seconds[phase] if work.seconds[phase] else 0.0
        if ratio > _SKIPPED * factors[phase] if phase in PHASES[:2] else teaches:
            share = _NEWEST if trainings else 1.0
            factors[phase] = share * ratio + (1 - share) * factors[phase]
    entries = {**_stored(), "model": MODEL, device: {"trainings": trainings + teaches, **factors}}
    with suppress(FrogError, OSError):
        write_atomically(default_cache_folder() / _FILE, json.dumps(entries, indent=1).encode())


def _stored() -> dict[str, dict[str, object]]:
    """What the file says, by device; nothing where it is missing, damaged or of another model."""
    with suppress(OSError, ValueError, RecursionError):
        entries = json.loads((default_cache_folder() / _FILE).read_text(encoding="utf-8"))
        if isinstance(entries, dict) and entries.get("model") == MODEL:
            return {device: entry for device, entry in entries.items() if isinstance(entry, dict)}
    return {}


class PhaseClock:
    """Measures phases that follow each other, without pauses.

    Attributes:
        seconds: of each phase that has ended, by its name.
    """

    def __init__(self, cancel: CancelToken) -> None:
        self._cancel = cancel
        self.seconds: dict[str, float] = {}
        self._began = self.now

    @property
    def now(self) -> float:
        """Seconds on a clock that stands still during pauses."""
        return time.perf_counter() - self._cancel.seconds_paused

    def end(self, phase: str) -> None:
        """A phase has ended, and the next one begins."""
        self.seconds[phase], self._began = self.now - self._began, self.now


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
    system = Path(os.environ.get("SYSTEMROOT", r"C:\Windows")) / "System32" / "nvcuda.dll"
    return "cuda" if Path("/proc/driver/nvidia/version").exists() or system.exists() else "cpu"
