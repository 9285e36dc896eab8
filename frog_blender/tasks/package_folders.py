"""Folders of installed packages: the current one, and leftovers to remove.

A folder whose libraries are loaded cannot be replaced on Windows. So each installation gets a new one, ``torch``,
``torch-2`` and so on, of which the last counts. ``calibration``, which has pycolmap and no torch, is another such name.
"""

import glob
import importlib.util
import itertools
import os
import re
import shutil
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

from ..engine.capture.sharing import lock_exclusively, open_shared

TORCH, CALIBRATION = "torch", "calibration"
"""Names of the folders."""
_REMOVED = "removed"
"""A file in a folder that is to go, but was in use."""


def hold() -> None:
    """Keeps other processes from removing torch's folder until this process ends. Call it before importing torch."""
    spec = importlib.util.find_spec("torch")
    if spec is not None and spec.origin is not None:
        with suppress(OSError):
            _held(Path(spec.origin))


_held = cache(open_shared)
"""A file that stays open, and so in use, until this process ends."""


def partial_prefix(folder: Path) -> str:
    """Prefix of folders that this process fills or empties."""
    return f"{folder.name}.partial-{os.getpid()}-"


def installed(folder: Path) -> Path | None:
    """The current installation of ``folder``; None if there is none."""
    return max(filter(has_package, _versions(folder)), key=_number, default=None)


def clear_remains(folder: Path) -> None:
    """Removes leftovers next to ``folder``: of interrupted installations, and earlier ones."""
    for path in remains(folder):
        _discard(path, folder)


def remains(folder: Path) -> list[Path]:
    """The folders that ``clear_remains`` would remove."""
    current, partial = installed(folder), []
    for path in folder.parent.glob(f"{glob.escape(folder.name)}.partial-*"):
        process = re.fullmatch(r".*\.partial-(?:(\d+)-)?.*?", path.name)
        if not (process and process[1] and _is_running(int(process[1]))) and path.is_dir() and not path.is_symlink():
            partial.append(path)
    return [*partial, *(path for path in _versions(folder) if path != current)]


def remove(folder: Path) -> bool:
    """Removes every installation of ``folder``; those in use stay until the next start. True if none is left."""
    versions = _versions(folder)
    for path in versions:
        _discard(path, folder)
        if path.exists():
            (path / _REMOVED).touch()
    return not any(path.exists() for path in versions)


def _versions(folder: Path) -> list[Path]:
    """All installations of ``folder``, whole ones and others."""
    paths = folder.parent.glob(f"{glob.escape(folder.name)}*")
    pattern = rf"{re.escape(folder.name)}(-\d+)?"
    return [path for path in paths if re.fullmatch(pattern, path.name) and path.is_dir() and not path.is_symlink()]


def _number(path: Path) -> int:
    version = path.name.rpartition("-")[2]
    return int(version) if version.isdigit() else 1


def package_of(folder: Path) -> str:
    """The package that a folder of this name is there for."""
    return "pycolmap" if folder.name.startswith(CALIBRATION) else "torch"


def has_package(folder: Path) -> bool:
    """Whether a folder contains the package that it is there for."""
    return _package_in(folder).is_file() and not (folder / _REMOVED).exists()


def _package_in(folder: Path) -> Path:
    return folder / package_of(folder) / "__init__.py"


def _is_running(process: int) -> bool:
    """Whether a process with this id exists; always false on Windows, where a folder in use cannot be moved anyway."""
    if sys.platform == "win32":
        return False
    try:
        os.kill(process, 0)
    except (OSError, OverflowError) as error:
        return not isinstance(error, ProcessLookupError)
    return True


def _discard(path: Path, folder: Path) -> None:
    """Removes a folder, or leaves it complete for the next start if it is in use."""
    loaded = getattr(sys.modules.get("torch"), "__file__", None)
    if (loaded and Path(loaded).is_relative_to(path)) or _is_held(path):
        return
    try:
        # Renamed first: on Windows this fails as a whole if a file is in use, where removing would stop half-way.
        trash = path.rename(path.with_name(f"{partial_prefix(folder)}{path.name}"))
    except OSError:
        return
    shutil.rmtree(trash, ignore_errors=True)


def _is_held(folder: Path) -> bool:
    """Whether any process uses the package in a folder."""
    if not _package_in(folder).is_file():
        return False
    try:
        with open_shared(_package_in(folder)) as file:
            return not lock_exclusively(file)
    except OSError:
        return True


def switch_to(partial: Path, folder: Path) -> Path:
    """Makes a folder of packages the current installation and returns its new path."""
    before = _versions(folder)
    first = max(map(_number, before), default=0) + 1
    targets = (folder.with_name(f"{folder.name}-{i}") if i > 1 else folder for i in itertools.count(first))
    target = next(path for path in targets if not os.path.lexists(path))
    partial.rename(target)
    for path in before:
        _discard(path, folder)
    return target
