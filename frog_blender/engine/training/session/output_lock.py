"""One training at a time writes a scene: a second one is told who does, in this process or another.

The operating system holds the lock and lets go of it when the process ends, however it ends. Its file lies in the
user's cache folder, so that beside the scene nothing is left.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ...capture.frames import default_cache_folder
from ...errors import FrogError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_BEHIND = 1 << 30  # the byte that Windows locks; nobody could read the others if they were locked


@contextmanager
def claimed(output: Path) -> Iterator[None]:
    """Inside the block ``output`` is this training's.

    A computer that keeps no locks is no reason not to train.

    Raises:
        FrogError: another training writes it.
    """
    path = _lock_path(output)
    try:
        file = _own(path)
    except BlockingIOError as error:
        raise FrogError(f"{output}: another training{error} writes it: wait for it, or choose another name.") from None
    except OSError:
        yield
        return
    try:
        yield
    finally:
        if os.name == "posix":  # while it is locked: later it may be another training's
            _remove(path)
        file.close()
        if os.name != "posix":  # where no open file can be removed
            _remove(path)


def _lock_path(output: Path) -> Path:
    where = os.path.join(os.path.realpath(output.parent), output.name)
    name = hashlib.blake2b(os.fsencode(os.path.normcase(where)), digest_size=16).hexdigest()
    return default_cache_folder() / f"{name}.lock"


def _own(path: Path) -> BinaryIO:
    """The file at ``path``, locked; BlockingIOError, which says by whom, where somebody else has locked it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        file = path.open("a+b")
        try:
            if not _locked(file):
                raise BlockingIOError(_who(file))
            if path.exists() and os.path.samestat(path.stat(), os.fstat(file.fileno())):
                file.truncate(0)
                file.write(str(os.getpid()).encode())
                file.flush()
                return file
        except BaseException:
            file.close()
            raise
        file.close()  # who had it before has removed it meanwhile


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _locked(file: BinaryIO) -> bool:
    """False when somebody else holds the lock of the file."""
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            file.seek(_BEHIND)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def _who(file: BinaryIO) -> str:
    with suppress(OSError, ValueError):
        file.seek(0)
        return f" (process {int(file.read(20))})"
    return ""
