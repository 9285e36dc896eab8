"""Files that can be read to their end: reading a pipe, a socket or a device would wait for ever, or never end."""

import stat
from pathlib import Path

from ..errors import FrogError, found_instead, in_words

_MOST_TEXT = 2**28  # bytes
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def regular_file(path: str | Path, expected: str) -> Path:
    """The path of a file that is there, through links; FrogError in one sentence for anything else. Opens nothing.

    Args:
        expected: what the file should be, such as "a .frog scene".
    """
    try:
        mode = Path(path).stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise found_instead(path, "no file", expected) from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise FrogError(f"{path}: could not be read ({getattr(error, 'strerror', None) or error}).") from error
    if not stat.S_ISREG(mode):
        raise found_instead(path, _KINDS.get(stat.S_IFMT(mode), "no regular file"), expected)
    return Path(path)


def utf8_name(path: str | Path) -> str:
    """A path as libraries take it that know no other encoding; FrogError for one that is not UTF-8."""
    name = str(path)
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise found_instead(name, "a name that is not UTF-8", "one that is: rename the file or its folder") from error
    return name


def check_length(path: Path, expected: str, most: int = _MOST_TEXT) -> None:
    """Checks the size of a text file before it is read.

    Args:
        expected: what the file should be, such as "a JSON file".

    Raises:
        FrogError: if it is not a file, or larger than any calibration.
    """
    length = regular_file(path, expected).stat().st_size
    if length > most:
        raise found_instead(path, f"{length:,} bytes", f"{expected} of at most {most:,}")


def read_text(path: Path, expected: str, most: int = _MOST_TEXT, *, foreign: bool = False) -> str:
    """The text of a file.

    Args:
        expected: what the file should be, such as "a JSON file".
        most: bytes.
        foreign: of another program, which may have written its names in any encoding: "\ufffd" stands for what is no
            UTF-8.

    Raises:
        FrogError: if it is not a file, too large, cannot be read, or is no UTF-8.
    """
    check_length(path, expected, most)
    try:
        with in_words(f"{path}: found a file that cannot be read", f", expected {expected}."):
            return path.read_text(encoding="utf-8-sig", errors="replace" if foreign else "strict")
    except UnicodeDecodeError as error:
        raise found_instead(path, "text that is no UTF-8", expected) from error
