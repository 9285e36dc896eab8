"""What a training tells while it runs, and the same as lines of JSON for a front end in another process. No torch.

Events have plain values alone: safe to pass between threads, and to any front end.
"""

from __future__ import annotations

import base64
import json
import math
import re
import zlib
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from ...io.plain_values import JsonObject


@dataclass(frozen=True)
class Event:
    """What a training tells: one of the kinds below."""


@dataclass(frozen=True)
class Stage(Event):
    """Work before the steps, as decoding frames and finding seed points, and after them, as saving."""

    name: str
    done: int
    total: int
    fraction: float = 0.0
    """Of the whole run by the clock, 0 to 1: it never falls."""
    seconds_left: float = 0.0
    """By the clock, to the end of the run: an estimate."""


@dataclass(frozen=True)
class Started(Event):
    """The steps begin: what is trained, and on what."""

    method: str
    steps: int | None
    """None when the training is limited by time instead."""
    cameras: int
    frames: int
    gaussians: int
    device: str = "cpu"
    """"cpu" or "cuda"."""
    pixels: int = 0
    """Of an image, in the mean over the cameras."""
    images: int = 0
    """Of the capture."""
    step: int = 0
    """That a resumed training begins with."""


@dataclass(frozen=True)
class Progress(Event):
    """A few times a second: where the training is. Seconds are of training, ``loss`` is a running mean."""

    step: int
    steps: int
    """An estimate when the training is limited by time."""
    seconds: float
    seconds_left: float
    """By the clock, to the end of the run: an estimate."""
    loss: float
    gaussians: int
    num_dynamic: int = 0
    """Those of them that the network deforms."""
    fraction: float = 0.0
    """Of the whole run by the clock, 0 to 1: it never falls."""


@dataclass(frozen=True)
class Statistics(Event):
    """After each Progress, for loggers: figures of its step."""

    step: int
    losses: dict[str, float]
    """What the loss of this step's image is the sum of, with weights: by name of ``registry.LOSSES``, and "alpha"."""
    rates: dict[str, float]
    """Learning rates by group of parameters."""
    added: int
    """Gaussians that densification and sampling have added since the run began, or was resumed."""
    removed: int
    """Those that were pruned or replaced since then."""


@dataclass(frozen=True)
class Reduced(Event):
    """A compression step was applied."""

    step: int
    message: str
    """What a compression step did, in words."""


@dataclass(frozen=True)
class Evaluated(Event):
    """The scene was compared with images; PSNR in dB."""

    step: int
    psnr: float
    split: str
    """"held-out", or "training" when nothing is held out."""
    seconds: float = 0.0
    """Of training so far."""


@dataclass(frozen=True)
class Preview(Event):
    """An image of the scene as it stands."""

    step: int
    image: NDArray[np.uint8] = field(repr=False)
    """(H, W, 3) uint8."""


@dataclass(frozen=True)
class WarningEvent(Event):
    """One sentence that the user is to read; the training goes on."""

    message: str


@dataclass(frozen=True)
class Saved(Event):
    """A checkpoint or a scene lies on the disk."""

    path: str


@dataclass(frozen=True)
class Finished(Event):
    """The last event: the scene is written. PSNR in dB."""

    path: str
    steps: int
    seconds: float
    """Of training, without evaluation and saving."""
    psnr: float | None
    """None where it could not be measured."""
    gaussians: int
    capacity: JsonObject = field(default_factory=dict, repr=False)
    """See SceneHeader."""
    phases: dict[str, float] = field(default_factory=dict)
    """Seconds by the clock, without pauses, of decoding, seeding, training and finishing."""


@dataclass(frozen=True)
class Cancelled(Event):
    """The last event of a training that was ended early."""

    step: int
    path: str | None
    """The scene that was saved; None when training had not begun."""


_LARGEST_SIDE = 1024  # pixels of an image; larger ones are sent with fewer


def line_of(event: Event) -> str:
    """An event as one line without its end. ``WarningEvent`` is called "warning"."""
    values = {field_.name: _plain(getattr(event, field_.name)) for field_ in fields(event)}
    word = re.sub(r"(?<!^)(?=[A-Z])", "_", type(event).__name__.removesuffix("Event")).lower()
    return json.dumps({"event": word, **values}, allow_nan=False)


def _plain(value: object) -> object:
    """A field as JSON takes it; None for a number that is not finite."""
    if isinstance(value, np.ndarray):
        return _packed(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _packed(image: NDArray[np.uint8]) -> dict[str, object]:
    """An image with at most _LARGEST_SIDE pixels a side. No PNG: who reads it may have nothing that opens one."""
    step = -(-max(image.shape[:2]) // _LARGEST_SIDE)
    smaller = np.ascontiguousarray(image[::step, ::step])
    deflated = base64.b64encode(zlib.compress(smaller.tobytes())).decode("ascii")
    return {"height": smaller.shape[0], "width": smaller.shape[1], "rgb": deflated}
