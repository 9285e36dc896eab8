"""Who else uses a file of the cache: readers share a lock, which whoever deletes must have alone.

The operating system lets go of a lock when its process ends. Windows needs none: it deletes no file that is in use.
"""

from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]


def open_shared(path: Path) -> BinaryIO:
    """The file, open and locked as long as it is: in use, with any number of others.

    Some network disks have no locks: what lies there is never had alone.

    Raises:
        BlockingIOError: while somebody has it alone.
        OSError: if it cannot be opened.
    """
    file = path.open("rb")
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise
    except OSError:
        pass
    return file


def lock_exclusively(file: BinaryIO) -> bool:
    """True, and the file is closed, when nobody else has shared it; else it stays shared."""
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        with suppress(OSError):  # asking for the file alone gave the shared lock away
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    file.close()
    return True
