"""How long a training will take: a model of a step's cost, and what trainings on this computer took before.

Nothing here needs torch: a panel or a command line asks before it is loaded. Only the training itself is estimated;
decoding and seed points come before it, once for a capture.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.frames import default_cache_folder
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...native import binding
from ..recipe import Recipe
from . import events
from .events import Event
from .job import TrainingJob

LARGEST_SIDE = 1600  # pixels, to which images are shrunk unless told otherwise
MODEL = 1  # raise it when the model of a step's cost changes: what was remembered no longer fits then

_MOMENTS = np.linspace(0.0, 1.0, 401)  # of a training, between which its cost is summed
_KEPT = 40  # trainings that are remembered
_FADING = 0.6  # what a training counts beside the one after it
_OTHER_RECIPE = 0.2  # what one of another recipe counts
_SHORT = 15.0  # modelled seconds below which a training says little of how long others take

# Seconds of a step on two quiet cores with AVX2 at 3.2 GHz (docs/experiments/rasterizer.md): fixed, for a
# thousand Gaussians, for a thousand of them and a thousand weights of the network, and for a million pixels drawn.
_FIXED, _GAUSSIANS, _WEIGHTS, _PIXELS = 6e-3, 0.53e-3, 0.054e-3, 190e-3
_WITH_AVX512 = 0.5  # of that, on two cores at 4.1 GHz
_CORES, _BY_CORES = 2, 0.7  # how a step gains from more cores; not measured


def pixels_of(cameras: Iterable[Camera], scale: float = 1.0) -> float:
    """Of an image at that scale, in the mean over the cameras."""
    return float(np.mean([camera.width * camera.height for camera in cameras])) * scale**2


def usual_scale(cameras: Iterable[Camera]) -> float:
    """The image size factor where none is chosen: at most LARGEST_SIDE pixels a side."""
    return min(1.0, LARGEST_SIDE / max(max(camera.width, camera.height) for camera in cameras))


@dataclass(frozen=True)
class Workload:
    """What a training has to do.

    Attributes:
        recipe: its schedules, Gaussians and network.
        steps: of the whole training.
        pixels: of a whole image.
    """

    recipe: Recipe
    steps: int
    pixels: float

    @classmethod
    def of(cls, capture: Capture, recipe: Recipe, steps: int | None = None, scale: float = 1.0) -> Workload:
        """For a capture at an image scale; ``steps`` None for the recipe's own."""
        return cls(recipe, steps or recipe.steps_for(capture.frame_count), pixels_of(capture.cameras, scale))

    @property
    def seconds(self) -> float:
        """On the computer that the model was measured on, see docs/experiments/rasterizer.md."""
        return float(self._cost[-1])

    def share_done(self, progress: float) -> float:
        """Of the whole cost, what lies before ``progress`` (0 to 1)."""
        return float(np.interp(progress, _MOMENTS, self._cost)) / self.seconds

    @cached_property
    def _cost(self) -> np.ndarray:
        """Seconds from the start to each of _MOMENTS."""
        r = self.recipe
        growing = np.clip(_MOMENTS, r.densify_from, r.densify_until) - r.densify_from
        grown = r.seed_gaussians * (1 + r.densify_growth) ** (growing / r.densify_every)
        gaussians = np.minimum(grown, [r.growth_limit_at(moment) for moment in _MOMENTS])
        whole = (1 - r.region_share) + r.region_share * r.region_size**2
        pixels = self.pixels * np.where(r.half_size_until > _MOMENTS, 0.25, whole)
        each = _GAUSSIANS + _WEIGHTS * _weights(r) / 1e3
        step = _FIXED + each * gaussians / 1e3 + _PIXELS * pixels / 1e6
        between = np.diff(_MOMENTS) * (step[1:] + step[:-1]) / 2
        return self.steps * np.concatenate([[0.0], np.cumsum(between)])


def _weights(recipe: Recipe) -> int:
    """Of the deformation network: multiplications for each Gaussian that moves."""
    r = recipe
    outputs = 3 + 3 + 4 + int(r.deformed_opacity) + 3 * r.deformed_sh
    heads = r.hidden_width * 5 * r.head_width + r.head_width * outputs if r.head_width else r.hidden_width * outputs
    return r.embedding_size * r.hidden_width + heads


@dataclass(frozen=True)
class Sensitivity:
    """A training that was finished.

    Attributes:
        device: "cpu" or "cuda".
        recipe: its name.
        modelled: seconds that its Workload says.
        seconds: that it took.
        model: MODEL when it was measured.
    """

    device: str
    recipe: str
    modelled: float
    seconds: float
    model: int = MODEL


@dataclass(frozen=True)
class Estimate:
    """How long a training will take.

    Attributes:
        seconds: None where nothing is known, on a GPU that nothing was trained on.
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


def estimate(work: Workload, device: str = "cpu") -> Estimate:
    """The time for ``work`` on "cpu" or "cuda", from the model and from what is remembered of this computer."""
    known = [one for one in remembered() if one.device == device]
    if known:
        weights = [
            _FADING**age * (1.0 if one.recipe == work.recipe.name else _OTHER_RECIPE)
            for age, one in enumerate(reversed(known))
        ]
        ratios = [math.log(one.seconds / one.modelled) for one in reversed(known)]
        return Estimate(work.seconds * math.exp(np.average(ratios, weights=weights)), device, len(known))
    if device != "cpu":
        return Estimate(None, device, 0)
    return Estimate(work.seconds * _this_processor(), device, 0)


def _this_processor() -> float:
    """How long a step takes here, roughly, over what it took where the model was measured."""
    try:
        wide = binding.instruction_set() == "avx512"
    except FrogError:  # no native library: then a training says so
        wide = False
    by_cores = (_CORES / (os.cpu_count() or _CORES)) ** _BY_CORES
    return by_cores * (_WITH_AVX512 if wide else 1.0)


def likely_device(name: str) -> str:
    """What ``choose_device`` will make of a name, without loading torch: "auto" is a GPU where there is a driver."""
    if name != "auto":
        return name
    torch = sys.modules.get("torch")
    if torch is not None:
        return "cuda" if torch.cuda.is_available() else "cpu"
    system = Path(os.environ.get("SYSTEMROOT", r"C:\Windows")) / "System32" / "nvcuda.dll"
    return "cuda" if Path("/proc/driver/nvidia/version").exists() or system.exists() else "cpu"


def about(seconds: float) -> str:
    """No more precisely than an estimate is: 48 -> "50 seconds", 250 -> "4 minutes", 9000 -> "2.5 hours"."""
    if seconds < 95:
        return f"{max(10, round(seconds, -1)):.0f} seconds"
    if seconds < 95 * 60:
        minutes = seconds / 60
        return f"{round(minutes) if minutes < 20 else 5 * round(minutes / 5)} minutes"
    return f"{seconds / 3600:.1f}".removesuffix(".0") + " hours"


def remembering(stream: Iterator[Event], job: TrainingJob) -> Iterator[Event]:
    """A job's events as they are; when it has finished, how long it took is remembered for later estimates.

    A training limited by time, one that goes on from a checkpoint (which another device may have begun), one of
    another method and a short trial, which mostly waits for what comes once, teach nothing.
    """
    started: events.Started | None = None
    for event in stream:
        if isinstance(event, events.Started) and event.steps and job.method == "frog" and not job.resume:
            started = event
        elif isinstance(event, events.Finished) and started and started.steps and event.seconds > 0:
            work = Workload(job.recipe, started.steps, started.pixels)
            if work.seconds >= _SHORT:
                remember(Sensitivity(started.device, job.recipe.name, work.seconds, event.seconds))
        yield event


def remember(measured: Sensitivity) -> None:
    """Adds a training to those that estimates rest on; a disk that does not take it changes nothing."""
    entries = [asdict(one) for one in [*remembered(), measured]][-_KEPT:]
    with suppress(FrogError, OSError):
        _file().parent.mkdir(parents=True, exist_ok=True)
        write_atomically(_file(), json.dumps(entries, indent=1).encode())


def remembered() -> list[Sensitivity]:
    """Trainings on this computer, oldest first; what a damaged file says besides is left out."""
    try:
        entries = json.loads(_file().read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return []
    found = [_measured(entry) for entry in entries] if isinstance(entries, list) else []
    return [one for one in found if one is not None]


def _measured(entry: Any) -> Sensitivity | None:
    try:
        one = Sensitivity(
            str(entry["device"]),
            str(entry["recipe"]),
            float(entry["modelled"]),
            float(entry["seconds"]),
            entry["model"],
        )
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    usable = 0 < one.seconds < math.inf and 0 < one.modelled < math.inf and one.model == MODEL
    return one if usable else None


def _file() -> Path:
    """Beside the decoded frames: it belongs to this computer and its user."""
    return default_cache_folder() / "training_times.json"
