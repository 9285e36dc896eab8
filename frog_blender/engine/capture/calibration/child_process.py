"""What a calibration leaves to processes of their own: where pycolmap or a matrix library may end them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ...io.child_process import Progress, Task
from ...io.plain_values import JsonObject
from .calibration import CalibrationRefused

_FUNCTIONS = {
    "standing": "standing_task:standing",
    "features": "feature_task:find_features",
    "synchronization": "clocks:synchronization",
    "scan": "scan_task:scan",
    "moving": "moving_task:moving",
}


def run(task: str, folder: Path, progress: Progress, cancelled: Callable[[], bool]) -> JsonObject:
    """Runs one of the tasks on the request in a folder, and returns its result.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras.
        Stopped: if ``cancelled`` said so; the process was ended.
        FrogError: if the process failed or died.
    """
    return _task(task).run(folder, progress, cancelled)


def run_several(
    task: str, folders: Sequence[Path], total: int, progress: Progress, cancelled: Callable[[], bool]
) -> list[JsonObject]:
    """``run`` on the requests of several folders at once.

    Args:
        total: how much all of them have to do, for ``progress``.

    Raises: as of ``run``; what one raises ends the others.
    """
    return _task(task).run_several(folders, total, progress, cancelled)


def _task(name: str) -> Task:
    return Task(f"capture.calibration.{_FUNCTIONS[name]}", _failure, CalibrationRefused)


def _failure(end: str) -> str:
    return f"The calibration's process {end}; nothing was written, and what is done is kept."
