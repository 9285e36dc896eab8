"""Which file a training may write, and the lock that keeps others from writing it. No torch.

It is one of its own capture, and never what another one was trained to. The operating system holds the lock and
releases it when the process ends, however it ends. The lock file lies in the user's cache folder, so that nothing is
left beside the scene.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from itertools import count, takewhile
from pathlib import Path
from typing import BinaryIO

from ...errors import FrogError, UsageError
from ...io.atomic_files import LONGEST_NAME, beginning
from ...io.cache_folder import default_cache_folder
from ...io.paths import is_network_path
from ...io.plain_values import JsonObject
from ...io.tensor_files import read_tensors


def checkpoint_path(scene: str | Path) -> Path:
    """Where the checkpoint of a scene file lies: in its folder, under its name, cut where the disk would not take a
    name as long."""
    path, ending = Path(scene), ".checkpoint"
    return path.with_name(beginning(path.name, LONGEST_NAME - len(ending)) + ending)


def check_unused(output: Path, advice: str = "another name keeps it") -> None:
    """UsageError where a scene or a checkpoint lies that nobody said may be replaced.

    Args:
        advice: what can be done, in the words of where the output was chosen.
    """
    if taken := _found(output):
        kind = "a file" if taken == output else "the checkpoint of a training"
        raise UsageError(f"{taken}: found {kind} there already; {advice}.")


def _found(output: Path) -> Path | None:
    """What a training to ``output`` would replace."""
    files = (output, checkpoint_path(output))
    return next((path for path in files if os.path.lexists(path) and not os.path.isdir(path)), None)


def free_output(output: Path, capture: Path) -> Path:
    """``output``, or that name with a number where a scene of another capture lies there.

    Where trainings of this capture lie under such names, the last that was cut short: it can be resumed.
    """
    for path in reversed(list(takewhile(_found, numbered_names(output, "_")))):
        progress = training_progress(path)
        if progress is not None and progress[0] < 1.0 and not is_of_another(path, capture):
            return path
    return next(path for path in numbered_names(output, "_") if not is_of_another(path, capture))


def unused_output(output: Path) -> Path:
    """``output`` where neither a scene nor a checkpoint lies, else the first free of the numbered names.

    ``room.frog``, ``room_2.frog``, ``room_3.frog``: a number of an earlier training's is counted on, not added to.
    """
    if _found(output) is None:
        return output
    name, _, digits = output.stem.rpartition("_")
    base = output.with_name(f"{name}{output.suffix}") if name and digits.isdecimal() else output
    return next(path for path in numbered_names(base if _found(base) else output, "_") if _found(path) is None)


def numbered_names(path: Path, joint: str) -> Iterator[Path]:
    """``path``, then the same name with 2, 3 and so on behind ``joint``, for ever."""
    yield path
    for index in count(2):
        yield path.with_name(f"{path.stem}{joint}{index}{path.suffix}")


def is_of_another(output: Path, capture: Path) -> bool:
    """True when the ``.frog`` or the checkpoint beside it says that it was made from another folder than ``capture``.

    A folder of the same name that is gone is taken for this one, moved.
    """
    here = capture.resolve()
    for path in (output, checkpoint_path(output)):
        folder = trained_from(path)
        there = Path(folder)  # which is looked for only where that calls no other computer
        if folder and there != here and (there.name != here.name or is_network_path(folder) or os.path.exists(there)):
            return True
    return False


def trained_from(path: Path) -> str:
    """The capture that a ``.frog`` or a checkpoint names; "" where it names none, or there is no such file.

    Cheap enough for every redraw of a panel: a file is opened once, and its arrays are not read.
    """
    header = header_of(path)
    try:
        return str(header["capture_path"] if "capture_path" in header else header["settings"]["capture"])
    except (TypeError, KeyError):
        return ""


def training_progress(scene: Path) -> tuple[float, int] | None:
    """How far the training of the checkpoint beside a scene came: the share of it, 0 to 1, and its steps; None where
    there is no checkpoint that can be read. As cheap as ``trained_from``.
    """
    state = header_of(checkpoint_path(scene))
    try:
        return float(state["progress"]), int(state["step_count"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def training_seconds(scene: Path) -> float | None:
    """How long the training of the checkpoint beside a scene took, without decoding and saving; None as above."""
    seconds = header_of(checkpoint_path(scene)).get("seconds")
    return seconds if isinstance(seconds, float) else None


def header_of(path: Path) -> JsonObject:
    """The plain values in a scene or a checkpoint; {} where there are none."""
    try:
        status = path.stat()
        return _read_header(str(path), status.st_mtime_ns, status.st_size)
    except OSError:
        return {}


@lru_cache(maxsize=32)
def _read_header(path: str, _changed: int, _size: int) -> JsonObject:
    try:
        _, metadata = read_tensors(path, "a .frog scene or a checkpoint", wanted=lambda name: False)
        values = json.loads(metadata["frog" if "frog" in metadata else "frog-checkpoint"])
        return values if isinstance(values, dict) else {}
    except (FrogError, ValueError, KeyError, RecursionError):
        return {}


try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_LOCKED_BYTE = 1 << 30  # on Windows, where locked bytes cannot be read: it lies behind the content


@contextmanager
def lock_output(output: Path) -> Iterator[None]:
    """Holds the lock of ``output`` inside the block. Where the system has no locks, nothing is locked.

    Raises:
        FrogError: another training holds it.
    """
    path = _lock_path(output)
    try:
        file = _acquire(path)
    except BlockingIOError as error:
        raise FrogError(
            f"{output}: another training{error} writes this file: wait for it, or choose another name."
        ) from None
    except OSError:
        yield
        return
    try:
        yield
    finally:
        if os.name == "posix":  # before it is released, after which it may be another training's
            _remove(path)
        file.close()
        if os.name != "posix":  # where no open file can be removed
            _remove(path)


def _lock_path(output: Path) -> Path:
    where = os.path.join(os.path.realpath(output.parent), output.name)
    name = hashlib.blake2b(os.fsencode(os.path.normcase(where)), digest_size=16).hexdigest()
    return default_cache_folder() / f"{name}.lock"


def _acquire(path: Path) -> BinaryIO:
    """The file at ``path``, locked; BlockingIOError, which names the owner, where another process has locked it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        file = path.open("a+b")
        try:
            if not _try_lock(file):
                raise BlockingIOError(_owner(file))
            if path.exists() and os.path.samestat(path.stat(), os.fstat(file.fileno())):
                file.truncate(0)
                file.write(str(os.getpid()).encode())
                file.flush()
                return file
        except BaseException:
            file.close()
            raise
        file.close()  # its former owner has removed it meanwhile


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _try_lock(file: BinaryIO) -> bool:
    """Locks the file; False when another process holds its lock."""
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            file.seek(_LOCKED_BYTE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def _owner(file: BinaryIO) -> str:
    """The process that holds the lock, in brackets; empty where the file does not say."""
    with suppress(OSError, ValueError):
        file.seek(0)
        return f" (process {int(file.read(20))})"
    return ""
