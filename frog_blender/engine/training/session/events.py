"""What a training says while it runs. Plain values only: safe to hand from thread to thread, and to any front end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Stage:
    """Work before training: decoding frames, finding seed points."""

    name: str
    done: int
    total: int


@dataclass(frozen=True)
class Started:
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


@dataclass(frozen=True)
class Progress:
    step: int
    steps: int
    """An estimate when the training is limited by time."""
    seconds: float
    seconds_left: float
    loss: float
    gaussians: int
    moving: int = 0
    """Those of them that the network moves."""


@dataclass(frozen=True)
class Reduced:
    step: int
    message: str
    """What a round took out of the model (see training.parsimony)."""


@dataclass(frozen=True)
class Evaluated:
    step: int
    psnr: float
    split: str
    """"held-out", or "training" when nothing is withheld."""
    seconds: float = 0.0
    """Of training so far."""


@dataclass(frozen=True)
class Preview:
    step: int
    image: NDArray[np.uint8]
    """(H, W, 3) uint8."""


@dataclass(frozen=True)
class CompressionPreview:
    """An image of what moves, what rests and what was left out, beside the scene."""

    path: str
    image: NDArray[np.uint8]
    """(H, W, 3) uint8."""


@dataclass(frozen=True)
class WarningEvent:
    message: str


@dataclass(frozen=True)
class Saved:
    path: str


@dataclass(frozen=True)
class Finished:
    path: str
    steps: int
    seconds: float
    psnr: float | None
    """None where it could not be measured."""
    gaussians: int
    capacity: dict[str, Any] = field(default_factory=dict)
    """See SceneHeader."""


@dataclass(frozen=True)
class Cancelled:
    step: int
    path: str | None
    """The scene as far as it came, None when training had not begun."""


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
