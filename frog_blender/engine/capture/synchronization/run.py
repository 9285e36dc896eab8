"""What all stages of a calibration share: what earlier runs kept, progress, an end, and processes of their own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from shutil import rmtree
from typing import TypeVar

from ...errors import FrogError
from ...io.child_process import Progress, Stopped, run_in_child
from ...io.plain_values import plain
from ...io.work_folder import WorkFolder, key_of

NAME = ".frog_calibration"
"""The hidden folder of a calibration's stages, beside its result."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class CalibrationRefused(FrogError):
    """The footage does not fix its cameras; the sentence says why, and what to film next time."""


@dataclass(frozen=True)
class Run:
    """A calibration as its stages see it.

    Attributes:
        work: keeps the stages, so that a second run with the same footage continues.
        progress: told a stage's name, and how much of how much is done.
        cancelled: asked several times a second; what it ends raises Stopped.
    """

    work: WorkFolder
    progress: Progress
    cancelled: Callable[[], bool]

    def check(self) -> None:
        """Called before each image: ends the work when it was cancelled."""
        if self.cancelled():
            raise Stopped

    def in_threads(
        self, stage: str, function: Callable[[_Item], _Result], items: Iterable[_Item], most: int = 64
    ) -> list[_Result]:
        """The results in order; OpenCV decodes and computes outside Python's lock, and numpy in part."""
        listed, results = list(items), []
        with ThreadPoolExecutor(min(most, os.cpu_count() or 1)) as threads:
            for result in threads.map(function, listed):
                self.check()
                results.append(result)
                self.progress(stage, len(results), len(listed))
        return results

    def in_child(self, function: Callable[..., _Result], *arguments: object) -> _Result:
        """What a function of calibration returns, run by a process of its own: a crash in a library ends that alone.

        Its arguments and its result pass as ``plain`` values. A last parameter ``tell`` is told its progress.
        """
        folder = self.work.path / f"{function.__name__}-{key_of(plain(arguments))}"
        result = run_in_child(
            function,
            *arguments,
            folder=folder,
            progress=self.progress,
            stopped=self.cancelled,
            failure=lambda end: f"The calibration's process {end}; nothing was written, and what is done is kept.",
            kind=CalibrationRefused,
        )
        rmtree(folder, ignore_errors=True)
        return result
