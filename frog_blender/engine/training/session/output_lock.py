"""Locks a scene's path, so that one training at a time writes it, in this process or another.

The operating system holds the lock and releases it when the process ends, however it ends. The lock file lies in the
user's cache folder, so that nothing is left beside the scene.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ...errors import FrogError
from ...io.cache_folder import default_cache_folder

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
