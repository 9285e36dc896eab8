"""Files that appear under their names when they are whole, with the permissions that the user wants."""

import glob
import hashlib
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import in_words

LONGEST_NAME = 255
"""Bytes that a file's name may have on the usual file systems."""
_LONGEST_BEGINNING = 100  # bytes of a temporary name that are the file's own
_OWNERS = stat.S_IRUSR | stat.S_IWUSR
_BINARY = getattr(os, "O_BINARY", 0)


def write_atomically(path: str | Path, content: bytes) -> None:
    """To a temporary name beside ``path``, flushed to the disk, then renamed: never half a file under that name.

    FrogError when it cannot be written; its cause is the OSError.
    """
    path = Path(path)
    with in_words(f"{path}: could not be written", "; nothing was changed."):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            file.write(content)


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write, which becomes ``path`` when the block ends; whatever ends it early leaves nothing behind.

    It gets the permissions of the file that it replaces, else those that the process gives to new files (umask).
    OSError when it cannot be written.
    """
    temporary = path.with_name(_temporary_name(path.name))  # known before it exists: a signal can come at any time
    mode = None
    try:
        with suppress(OSError):
            mode = stat.S_IMODE(path.stat().st_mode)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY
        # Its owner may write it until it is whole: Windows does not delete a file that is read-only.
        with os.fdopen(os.open(temporary, flags, 0o666 if mode is None else mode | _OWNERS), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        if mode is not None:
            with suppress(OSError):  # the content is there: some disks know no permissions
                path.chmod(mode)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_writable(path: Path) -> None:
    """FrogError when no file could be written under that name: it is too long, or the folder takes none."""
    temporary = path.with_name(_temporary_name(path.name))
    with in_words(f"{path}: no file can have this name"), suppress(FileNotFoundError):
        os.lstat(path)  # says so of a name that is too long
    try:
        with in_words(f"{path.parent}: no file can be written here"):
            temporary.open("xb").close()
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_partial_files(path: str | Path) -> None:
    """What processes left that were killed while they wrote ``path``."""
    path = Path(path)
    for part in path.parent.glob(f".{glob.escape(beginning(path.name))}.*.part"):
        with suppress(OSError):
            part.unlink()


def beginning(name: str, most: int = _LONGEST_BEGINNING) -> str:
    """A file's name, or where it has more than ``most`` bytes its beginning and a hash of all of it: no longer, and no
    two alike."""
    if len(os.fsencode(name)) <= most:
        return name
    tag = hashlib.blake2b(os.fsencode(name), digest_size=4).hexdigest()
    kept = os.fsencode(name)[: most - len(tag) - 1].decode(errors="ignore")
    return f"{kept}-{tag}"


def _temporary_name(name: str) -> str:
    return f".{beginning(name)}.{secrets.token_hex(4)}.part"
