"""What all stages of a calibration share: what earlier runs kept, progress, an end, and processes of their own."""

from __future__ import annotations

import hashlib
import importlib
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Any, TypeVar, get_type_hints

import numpy as np

from ...arrays import Array
from ...errors import FrogError, found_instead
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, RESULT, Progress, Stopped, Task
from ...io.numpy_files import read_npz
from ...io.plain_values import JsonObject, UnfitValue, plain, typed

NAME = ".frog_calibration"
"""The hidden folder of a calibration's stages, beside its result."""
_VERSION = 4  # raise it when the same input would give another result
_MOST = 2**28  # numbers of one stage
_SEAL = "seal"

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class CalibrationRefused(FrogError):
    """The footage does not fix its cameras; the sentence says why, and what to film next time."""


def key_of(*parts: object) -> str:
    """A hash of plain values and arrays."""
    digest = hashlib.blake2b(str(_VERSION).encode(), digest_size=12)
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype} {part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            digest.update(json.dumps(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()


@dataclass(frozen=True)
class WorkFolder:
    """Stages of earlier runs, each kept under a hash of all that decides it; made when the first one is.

    A hash of the arrays lies beside them: what is not as it was kept is done again.
    """

    path: Path

    def file(self, stage: str, key: str) -> Path:
        """Where a stage's result lies."""
        return self.path / f"{stage}-{key}.npz"

    def load(self, stage: str, key: str) -> dict[str, Array] | None:
        """The arrays of a stage; None where it was not kept, or its file is not as it was."""
        path = self.file(stage, key)
        if not path.is_file():
            return None
        try:
            arrays = read_npz(path, "a stage of a calibration", lambda name, shape: None, _MOST)
        except FrogError:
            return None
        seal = arrays.pop(_SEAL, None)
        return arrays if seal is not None and np.array_equal(seal, _seal(stage, arrays)) else None

    def keep(self, stage: str, key: str, arrays: Mapping[str, Array]) -> Path:
        """Writes a stage's arrays, whole or not at all; older results of the stage's name stay."""
        content = io.BytesIO()
        np.savez(content, **arrays, **{_SEAL: _seal(stage, arrays)})
        path = self.file(stage, key)
        write_atomically(path, content.getvalue())
        return path

    def kept(self, stage: str, key: str, make: Callable[[], Mapping[str, Array]]) -> Mapping[str, Array]:
        """A stage's arrays of an earlier run, or new ones, which are kept."""
        arrays: Mapping[str, Array] | None = self.load(stage, key)
        if arrays is None:
            arrays = make()
            self.keep(stage, key, arrays)
        return arrays


def _seal(stage: str, arrays: Mapping[str, Array]) -> Array:
    """(12,) uint8 hash of a stage's arrays and their names."""
    parts = [part for name in sorted(arrays) for part in (name, arrays[name])]
    return np.frombuffer(bytes.fromhex(key_of(stage, *parts)), np.uint8)


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
