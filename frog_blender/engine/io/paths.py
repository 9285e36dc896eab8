"""Paths that a file says, which may come from anybody."""

from pathlib import Path

from ..errors import brief
from .plain_values import UnfitValue
from .regular_file import regular_file

_LONGEST_NAME = 1024  # characters


def is_network_path(path: str) -> bool:
    r"""True for a path by which Windows would call another computer or speak to a device.

    Windows takes strokes of either kind for the same: ``\\server\share``, ``//server/share`` and both mixtures begin
    with two, as ``\\?\UNC\server\share`` and ``\\.\pipe\name`` do; ``\??\UNC\server\share`` does not. The question is
    the same on every system, so that a scene is treated alike by all.
    """
    return path.replace("/", "\\").startswith(("\\\\", "\\??\\"))


def read_beside(path: Path, name: str, what: str, most: int) -> bytes:
    """What a file holds that another names as its own part: in its folder or one below, never in another place.

    Args:
        path: of the file that names it.
        what: the part, such as "a buffer".
        most: bytes.

    Raises:
        UnfitValue: for another place, and more bytes.
        FrogError, OSError: for a file that is not there, or cannot be read.
    """
    if len(name) > _LONGEST_NAME:
        raise UnfitValue(f"{what} at {brief(name[:60])}", f"a name of {_LONGEST_NAME:,} characters at most")
    if ":" in name or "\\" in name or "\0" in name or not name or ".." in name.split("/") or name.startswith("/"):
        raise UnfitValue(f"{what} at {brief(name)}", "one in the folder of the file")
    file = regular_file(path.parent / name, what)
    if file.stat().st_size > most:
        raise UnfitValue(f"{what} of more than {most:,} bytes", "a smaller one")
    return file.read_bytes()
