"""Which file a training may write: one of its own capture, and never what another one was trained to. No torch."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from functools import lru_cache
from itertools import count
from pathlib import Path

from ...errors import FrogError
from ...io.atomic_files import LONGEST_NAME, beginning
from ...io.paths import is_network_path
from ...io.tensor_files import read_tensors


def checkpoint_path(scene: str | Path) -> Path:
    """Where the checkpoint of a scene file lies."""
    return beside(Path(scene), ".checkpoint")


def beside(scene: Path, ending: str) -> Path:
    """``scene``'s name and ``ending``, in the same folder; cut where the disk would not take a name as long."""
    return scene.with_name(beginning(scene.name, LONGEST_NAME - len(ending)) + ending)


def check_unused(output: Path, advice: str = "another name keeps it") -> None:
    """FrogError where a scene or a checkpoint lies that nobody said may be replaced.

    Args:
        advice: what can be done, in the words of where the output was chosen.
    """
    found = _found(output)
    if found is None:
        return
    kind = "a file" if found == output else "the checkpoint of a training"
    raise FrogError(f"{found}: found {kind} there already; {advice}.")


def _found(output: Path) -> Path | None:
    """What a training to ``output`` would replace."""
    files = (output, checkpoint_path(output))
    return next((path for path in files if os.path.lexists(path) and not os.path.isdir(path)), None)


def free_output(output: Path, capture: Path) -> Path:
    """``output``, or that name with a number where a scene of another capture lies there."""
    return next(path for path in numbered_names(output, "_") if not is_of_another(path, capture))


def unused_output(output: Path) -> Path:
    """``output`` where neither a scene nor a checkpoint lies, else the first free of the numbered names.

    ``room.frog``, ``room_2.frog``, ``room_3.frog``: a number of an earlier training's is counted on, not added to.
    """
    if _found(output) is None:
        return output
    name, _, number = output.stem.rpartition("_")
    base = output.with_name(f"{name}{output.suffix}") if name and number.isdecimal() else output
    return next(path for path in numbered_names(base if _found(base) else output, "_") if _found(path) is None)


def numbered_names(path: Path, joint: str) -> Iterator[Path]:
    """``path``, then the same name with 2, 3 and so on behind ``joint``, for ever."""
    yield path
    for number in count(2):
        yield path.with_name(f"{path.stem}{joint}{number}{path.suffix}")


def is_of_another(output: Path, capture: Path) -> bool:
    """True when the ``.frog`` or the checkpoint beside it says that it was made from another folder than ``capture``.

    A folder of the same name that is gone is taken for this one, moved.
    """
    here = capture.resolve()
    made = [found for path in (output, checkpoint_path(output)) if (found := trained_from(path))]
    return any(_is_another(found, here) for found in made)


def _is_another(found: str, here: Path) -> bool:
    """What a file says is looked for only where that calls no other computer."""
    there = Path(found)
    return there != here and (there.name != here.name or is_network_path(found) or os.path.exists(there))


def trained_from(path: Path) -> str:
    """The capture that a ``.frog`` or a checkpoint names; "" where it names none, or there is no such file.

    Cheap enough for every redraw of a panel: a file is opened once, and its arrays are not read.
    """
    try:
        status = path.stat()
    except OSError:
        return ""
    return _named_by(str(path), status.st_mtime_ns, status.st_size)


def training_progress(scene: Path) -> tuple[float, int] | None:
    """How far the training of the checkpoint beside a scene came: the share of it, 0 to 1, and its steps; None where
    there is no checkpoint that can be read. As cheap as ``trained_from``.
    """
    path = checkpoint_path(scene)
    try:
        status = path.stat()
    except OSError:
        return None
    return _progress_in(str(path), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=32)
def _progress_in(path: str, _changed: int, _size: int) -> tuple[float, int] | None:
    try:
        _, metadata = read_tensors(path, "a checkpoint", wanted=lambda name: False)
        state = json.loads(metadata["frog-checkpoint"])
        return float(state["progress"]), int(state["step_count"])
    except (FrogError, ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None


@lru_cache(maxsize=32)
def _named_by(path: str, _changed: int, _size: int) -> str:
    try:
        _, metadata = read_tensors(path, "a .frog scene or a checkpoint", wanted=lambda name: False)
        if "frog" in metadata:
            return str(json.loads(metadata["frog"])["capture_path"])
        return str(json.loads(metadata["frog-checkpoint"])["settings"]["capture"])
    except (FrogError, ValueError, TypeError, KeyError, RecursionError):
        return ""
