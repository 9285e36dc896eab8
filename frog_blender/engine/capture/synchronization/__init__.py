"""When each camera's frames were taken: offsets, rates and drift of the films' clocks, to a fraction of a frame."""

from __future__ import annotations

from .report import draw_curves
from .synchronization import CameraClock, RunnerUp, Synchronization, read_synchronization
from .synchronize import synchronize
from .tracks import NamedTracks

__all__ = [
    "CameraClock",
    "NamedTracks",
    "RunnerUp",
    "Synchronization",
    "draw_curves",
    "read_synchronization",
    "synchronize",
]
