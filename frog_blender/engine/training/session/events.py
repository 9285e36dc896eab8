"""Events of a training, with plain values alone: safe to pass between threads, and to any front end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...io.plain_values import JsonObject


@dataclass(frozen=True)
class Stage:
    """Work before training: decoding frames, finding seed points."""

    name: str
    done: int
    total: int


@dataclass(frozen=True)
class Started:
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


@dataclass(frozen=True)
class Progress:
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


@dataclass(frozen=True)
class Reduced:
    """A compression step was applied."""

    step: int
    message: str
    """What a compression step did, in words."""


@dataclass(frozen=True)
class Evaluated:
    """The scene was compared with images; PSNR in dB."""

    step: int
    psnr: float
    split: str
    """"held-out", or "training" when nothing is held out."""
    seconds: float = 0.0
    """Of training so far."""


@dataclass(frozen=True)
class Preview:
    """An image of the scene as it stands."""

    step: int
    image: NDArray[np.uint8]
    """(H, W, 3) uint8."""


@dataclass(frozen=True)
class CompressionPreview:
    """The image beside the scene that shows dynamic, static and pruned Gaussians."""

    path: str
    image: NDArray[np.uint8]
    """(H, W, 3) uint8."""


@dataclass(frozen=True)
class WarningEvent:
    """One sentence that the user is to read; the training goes on."""

    message: str


@dataclass(frozen=True)
class Saved:
    """A checkpoint or a scene lies on the disk."""

    path: str


@dataclass(frozen=True)
class Finished:
    """The last event: the scene is written. PSNR in dB."""

    path: str
    steps: int
    seconds: float
    """Of training, without evaluation and saving."""
    psnr: float | None
    """None where it could not be measured."""
    gaussians: int
    capacity: JsonObject = field(default_factory=dict)
    """See SceneHeader."""
    phases: dict[str, float] = field(default_factory=dict)
    """Seconds by the clock, without pauses, of decoding, seeding, training and finishing."""


@dataclass(frozen=True)
class Cancelled:
    """The last event of a training that was ended early."""

    step: int
    path: str | None
    """The scene that was saved; None when training had not begun."""


Event = (
    Stage
    | Started
    | Progress
    | Reduced
    | Evaluated
    | Preview
    | CompressionPreview
    | WarningEvent
    | Saved
    | Finished
    | Cancelled
)
