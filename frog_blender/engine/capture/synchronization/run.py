"""What all stages of a calibration share: what earlier runs kept, progress, an end, and processes of their own."""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from shutil import rmtree
from typing import Any, TypeVar, get_type_hints

from ...errors import FrogError, found_instead
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, RESULT, Progress, Stopped, Task
from ...io.plain_values import JsonObject, UnfitValue, plain, typed
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
        *_, room, module = function.__module__.split(".")
        request = {"room": room, "module": module, "function": function.__name__, "arguments": plain(arguments)}
        folder = self.work.path / f"{function.__name__}-{key_of(request)}"
        write_atomically(folder / REQUEST, json.dumps(request).encode())
        given = CHILD.run(folder, self.progress, self.cancelled)
        try:
            result: _Result = typed(get_type_hints(function)["return"], given["result"], "a result")
        except (KeyError, UnfitValue) as error:
            raise found_instead(folder / RESULT, f"a damaged result ({error})", "a whole one") from error
        rmtree(folder, ignore_errors=True)
        return result


def answer(request: JsonObject, tell: Progress) -> JsonObject:
    """The child's side of ``Run.in_child``: runs the function that a request names, of these two rooms."""
    room, module, name = (str(request[key]) for key in ("room", "module", "function"))
    if room not in ("calibration", "synchronization") or not module.isidentifier():
        raise FrogError(f"{room}.{module}: expected a function of calibration.")
    function = getattr(importlib.import_module(f"...{room}.{module}", __name__), name)
    hints = get_type_hints(function)
    del hints["return"]
    more: dict[str, Any] = {"tell": tell} if hints.pop("tell", None) else {}
    given = zip(hints.items(), request["arguments"], strict=True)
    return {"result": plain(function(*(typed(hint, value, key) for (key, hint), value in given), **more))}


CHILD = Task(
    "capture.synchronization.run:answer",
    lambda end: f"The calibration's process {end}; nothing was written, and what is done is kept.",
    CalibrationRefused,
)
