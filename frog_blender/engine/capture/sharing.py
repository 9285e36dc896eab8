"""Who else uses a file of the cache: readers share a lock, which whoever deletes must have alone.

The operating system lets go of a lock when its process ends. Windows needs none: it deletes no file that is in use.
"""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]


def open_shared(path: Path) -> BinaryIO | None:
    """The file, open and locked as long as it is: in use, with any number of others. None where it cannot be."""
    with suppress(OSError), ExitStack() as closing:
        file = closing.enter_context(path.open("rb"))
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        closing.pop_all()
        return file
    return None


def lock_exclusively(file: BinaryIO | None) -> bool:
    """True, and the file is closed, when nobody else has shared it; else it stays shared."""
    if file is None:
        return False
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        with suppress(OSError):  # asking for the file alone gave the shared lock away
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    file.close()
    return True
