"""Cameras that were found beside given ones: made the capture's own, and back. No content is ever lost.

What is in use has the name that readers look for. What is set aside keeps its name with ``_given`` or ``_found`` at its
end, and a number where another file has that name.
"""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import FrogError
from ...io.atomic_files import write_atomically
from .result_files import CAMERAS, free_path

_IN_USE = {"cameras_found": CAMERAS, "transforms_found": "transforms.json"}
"""Under which name readers take what a calibration found."""
_SOONER = ("poses_bounds.npy", "transforms.json", "transforms_train.json", "dataset.json", "cameras_parameters.txt")
"""What readers take sooner than ``cameras_opencv.json``; ``poses_bounds.npy`` sooner than the others as well."""


def found_beside(folder: Path) -> Path | None:
    """The newest calibration that was found and is not in use; None where there is none. FrogError if unreadable."""
    return _newest(folder, [(path, name) for stem, name in _IN_USE.items() for path in _named(folder, stem, name)])


def given_beside(folder: Path) -> Path | None:
    """The newest calibration that was given and set aside; None where there is none. FrogError if unreadable."""
    names = dict.fromkeys((*_SOONER, *_IN_USE.values()))
    return _newest(folder, [(path, name) for name in names for path in _named(folder, _given(name), name)])


def use_found(folder: Path) -> tuple[Path, list[Path]]:
    """Makes the newest found calibration the one in use; returns its file, and those that keep what was in use before.

    Whatever ends this early leaves one of the two in use, whole.

    Raises:
        FrogError: if none was found, or a file cannot be read or written.
    """
    found = found_beside(folder)
    if found is None:
        raise FrogError(f"{folder}: found no cameras_found.json that is not in use, expected one of frog calibrate.")
    name = next(name for stem, name in _IN_USE.items() if found.stem.startswith(stem))
    path, content = folder / name, _content(found)
    kept = [_kept(path, _given(name))] if path.is_file() else []
    write_atomically(path, content)
    sooner = _SOONER if name == CAMERAS else _SOONER[:1]
    for other in (folder / each for each in sooner):
        if other.is_file():
            kept.append(_kept(other, _given(other.name)))
            other.unlink()
    return path, kept


def use_given(folder: Path) -> Path:
    """Takes ``use_found`` back: the newest calibration that was set aside is in use again, and the found one kept.

    Raises:
        FrogError: if none was set aside, or a file cannot be read or written.
    """
    given = given_beside(folder)
    if given is None:
        raise FrogError(f"{folder}: found no calibration that was set aside, such as cameras_given.json.")
    names = dict.fromkeys((*_SOONER, *_IN_USE.values()))
    name = next(name for name in names if given in _named(folder, _given(name), name))
    path, content = folder / name, _content(given)
    for stem, used in _IN_USE.items():
        if used == name and path.is_file():
            _kept(path, stem)
    write_atomically(path, content)
    for stem, used in _IN_USE.items():
        if used != name and any(_is_same(found, folder / used) for found in _named(folder, stem, used)):
            (folder / used).unlink()
    return path


def _given(name: str) -> str:
    return f"{Path(name).stem.removesuffix('_opencv')}_given"


def _named(folder: Path, stem: str, name: str) -> list[Path]:
    """``stem``, or that with a number, with the ending of ``name``."""
    suffix = Path(name).suffix
    paths = folder.glob(f"{stem}*{suffix}")
    return [path for path in paths if path.stem == stem or path.stem.removeprefix(f"{stem}_").isdigit()]


def _newest(folder: Path, paths: list[tuple[Path, str]]) -> Path | None:
    """Of files, with the names under which they would be in use, the newest that is not."""
    unused = [path for path, name in paths if path.is_file() and not _is_same(path, folder / name)]
    return max(unused, key=lambda path: (path.stat().st_mtime_ns, len(path.name), path.name), default=None)


def _is_same(path: Path, other: Path) -> bool:
    return other.is_file() and os.path.getsize(path) == os.path.getsize(other) and _content(path) == _content(other)


def _kept(path: Path, stem: str) -> Path:
    """A file with the same content, under a name that nothing else has."""
    content = _content(path)
    copy = free_path(path.parent, f"{stem}{path.suffix}", stem, content, given=False)
    if not copy.exists():
        write_atomically(copy, content)
    return copy


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FrogError(f"{path}: could not be read ({error.strerror or error}), expected a calibration.") from error
