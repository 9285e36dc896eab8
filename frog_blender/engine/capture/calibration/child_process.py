"""Runs a task of ``child`` in a process of its own: whatever ends that one, this one goes on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path

from ...errors import FrogError, brief, how_it_ended
from ...io.plain_values import JsonObject, UnfitValue, entries, plain_json
from .calibration import CalibrationRefused

Progress = Callable[[str, int, int], None]
"""Told a stage's name, and how much of how much is done."""
REQUEST, RESULT = "request.json", "result.json"
"""Files of a task's folder."""
_PACKAGE = Path(__file__).parents[3]  # of frog_blender, or of an extension that holds it
_LOOKS = 0.1  # seconds between questions whether to stop
_LAST_LINES = 3
_MOST_TEXT = 2**26


class CalibrationCancelled(Exception):
    """The caller asked for an end. No FrogError: nothing is wrong with the footage."""


def run(task: str, folder: Path, progress: Progress, cancelled: Callable[[], bool]) -> JsonObject:
    """Runs a task on the request in a folder, and returns its result.

    Raises:
        CalibrationRefused: if the footage does not fix its cameras.
        CalibrationCancelled: if ``cancelled`` said so; the process was ended.
        FrogError: if the process failed or died.
    """
    (folder / RESULT).unlink(missing_ok=True)
    command = [sys.executable, "-P", "-m", f"{_PACKAGE.name}.{'.'.join(_module())}", task, str(folder)]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(_PACKAGE.parent), *filter(None, sys.path)]),
        "PYTHONIOENCODING": "utf-8",
        "OPENBLAS_NUM_THREADS": "1",  # its threads wait for each other on matrices as small as these
    }
    process = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.PIPE,  # closed when this process ends, which ends the child
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
    )
    said: list[str] = []
    readers = [
        threading.Thread(target=_follow, args=(process.stdout, progress), daemon=True),
        threading.Thread(target=lambda: said.extend(process.stderr or ()), daemon=True),
    ]
    try:
        for reader in readers:
            reader.start()
        while True:
            try:
                code = process.wait(_LOOKS)
                break
            except subprocess.TimeoutExpired:
                if cancelled():
                    raise CalibrationCancelled from None
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        for reader in readers:
            reader.join()
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                stream.close()
    return _result(folder / RESULT, code, said)


def run_several(
    task: str, folders: Sequence[Path], whole: int, progress: Progress, cancelled: Callable[[], bool]
) -> list[JsonObject]:
    """``run`` on the requests of several folders at once.

    Args:
        whole: how much all of them have to do, for ``progress``.

    Raises: as of ``run``; what one raises ends the others.
    """
    ended, done = threading.Event(), [0] * len(folders)

    def teller(place: int) -> Progress:
        def tell(stage: str, so_far: int, _all: int) -> None:
            done[place] = so_far
            progress(stage, sum(done), whole)

        return tell

    with ThreadPoolExecutor(len(folders)) as threads:
        futures = [
            threads.submit(run, task, folder, teller(place), ended.is_set) for place, folder in enumerate(folders)
        ]
        try:
            while wait(futures, _LOOKS, FIRST_EXCEPTION).not_done:
                if any(future.done() and future.exception() for future in futures):
                    break
                if cancelled():
                    raise CalibrationCancelled
        finally:
            ended.set()
    failures = [error for future in futures if (error := future.exception()) is not None]
    for failure in sorted(failures, key=lambda error: isinstance(error, CalibrationCancelled)):
        raise failure
    return [future.result() for future in futures]


def _result(path: Path, code: int, said: list[str]) -> JsonObject:
    """What the child wrote; raises for what went wrong there."""
    if code != 0 or not path.is_file():
        last = brief(" ".join(line.strip() for line in said[-_LAST_LINES:])) if said else "it said nothing"
        how = how_it_ended(code)
        raise FrogError(f"The calibration's process {how} ({last}); nothing was written, and what is done is kept.")
    try:
        if path.stat().st_size > _MOST_TEXT:
            raise UnfitValue(f"{path.stat().st_size} bytes", "less")
        result = entries(plain_json(path.read_text(encoding="utf-8"), "a result"), "a result")
    except (OSError, UnfitValue) as error:
        raise FrogError(f"{path}: found a result that cannot be read ({brief(error)}).") from error
    if "refused" in result:
        raise CalibrationRefused(result["refused"])
    if "error" in result:
        raise FrogError(result["error"])
    return result


def _module() -> tuple[str, ...]:
    """The child's module below the package."""
    return (*Path(__file__).parent.relative_to(_PACKAGE).parts, "child")


def _follow(stream: object, progress: Progress) -> None:
    """Passes the child's lines ``{"stage": ..., "done": ..., "all": ...}`` on; other lines are nobody's."""
    for line in stream or ():  # type: ignore[attr-defined]
        try:
            told = json.loads(line)
            progress(str(told["stage"]), int(told["done"]), int(told["all"]))
        except (ValueError, KeyError, TypeError):
            continue
