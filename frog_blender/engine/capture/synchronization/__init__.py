"""When each camera's frames were taken: offsets, rates and drift of the films' clocks, to a fraction of a frame."""

from __future__ import annotations

from .curves import draw_curves
from .synchronization import CameraClock, RunnerUp, Synchronization
from .synchronize import synchronize
from .work import SynchronizationCancelled

__all__ = [
    "CameraClock",
    "RunnerUp",
    "Synchronization",
    "SynchronizationCancelled",
    "draw_curves",
    "synchronize",
]
