"""When each camera's frames were taken: offsets, rates and drift of the films' clocks, to a fraction of a frame."""

from __future__ import annotations

from .carry import CarriedPoints, carry, common_times
from .curves import draw_curves
from .lags import NamedTracks
from .moving_points import MovingPoints
from .solve import Clock
from .synchronization import CameraClock, RunnerUp, Synchronization
from .synchronize import synchronize
from .work import SynchronizationCancelled

__all__ = [
    "CameraClock",
    "CarriedPoints",
    "Clock",
    "MovingPoints",
    "NamedTracks",
    "RunnerUp",
    "Synchronization",
    "SynchronizationCancelled",
    "carry",
    "common_times",
    "draw_curves",
    "synchronize",
]
