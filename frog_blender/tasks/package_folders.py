"""Folders of installed packages: the current one, and leftovers to remove.

A folder whose libraries are loaded cannot be replaced on Windows. So each installation gets a new one, ``torch``,
``torch-2`` and so on, and the file ``torch.current`` beside them names the one that counts, unless that is ``torch``.
``calibration``, which has pycolmap and no torch, is another such name.
"""

from __future__ import annotations

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
from typing import BinaryIO

from ..engine.capture.sharing import lock_exclusively, open_shared

TORCH, CALIBRATION = "torch", "calibration"
"""Names of the folders."""
_POINTER = ".current"


def hold() -> None:
    """Keeps other processes from removing torch's folder until this process ends. Call it before importing torch."""
    found = _loaded_torch()
    if found is None:
        spec = importlib.util.find_spec("torch")
        found = spec.origin if spec is not None else None
    if found is not None:
        with suppress(OSError):
            _held(found)


@cache
def _held(path: str) -> BinaryIO:
    """A file that stays open, and so in use, until this process ends; OSError if it cannot be opened."""
    file = open_shared(Path(path))
    if file is None:
        raise OSError(path)
    return file


def partial_prefix(folder: Path) -> str:
    """Prefix of folders that this process fills or empties."""
    return f"{folder.name}.partial-{os.getpid()}-"


def installed(folder: Path) -> Path | None:
    """The current installation of ``folder``; None if there is none."""
    try:
        named = (folder.parent / f"{folder.name}{_POINTER}").read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        named = folder.name
    choices = [folder.with_name(named)] if _is_version(named, folder) else []
    return next((path for path in [*choices, folder] if has_package(path)), None)


def clear_remains(folder: Path) -> None:
    """Removes leftovers next to ``folder``: of interrupted installations, and earlier ones."""
    for path in remains(folder):
        _discard(path, folder)


def remains(folder: Path) -> list[Path]:
    """The folders that ``clear_remains`` would remove."""
    current, found = installed(folder), []
    for path in folder.parent.glob(f"{glob.escape(folder.name)}*"):
        partial = re.fullmatch(rf"{re.escape(folder.name)}\.partial-(?:(\d+)-)?.*", path.name)
        is_earlier = current is not None and path != current and _is_version(path.name, folder)
        is_partial = partial is not None and not (partial[1] and _is_running(int(partial[1])))
        if (is_earlier or is_partial) and path.is_dir() and not path.is_symlink():
            found.append(path)
    return found


def remove(folder: Path) -> bool:
    """Removes every installation of ``folder``; those in use stay until the next start. True if none is left."""
    (folder.parent / f"{folder.name}{_POINTER}").unlink(missing_ok=True)
    found = folder.parent.glob(f"{glob.escape(folder.name)}*")
    versions = [path for path in found if _is_version(path.name, folder) and path.is_dir() and not path.is_symlink()]
    for path in versions:
        _discard(path, folder)
    return not any(path.exists() for path in versions)


def _is_version(name: str, folder: Path) -> bool:
    return re.fullmatch(rf"{re.escape(folder.name)}(-\d+)?", name) is not None


def package_of(folder: Path) -> str:
    """The package that a folder of this name is there for."""
    return "pycolmap" if folder.name.startswith(CALIBRATION) else "torch"


def has_package(folder: Path) -> bool:
    """Whether a folder contains the package that it is there for."""
    return _package_in(folder).is_file()


def _package_in(folder: Path) -> Path:
    return folder / package_of(folder) / "__init__.py"


def _is_running(process: int) -> bool:
    """Whether a process with this id exists; always false on Windows, where a folder in use cannot be moved anyway."""
    if sys.platform == "win32":
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _discard(path: Path, folder: Path) -> None:
    """Removes a folder, or leaves it complete for the next start if it is in use."""
    loaded = _loaded_torch()
    if (loaded and Path(loaded).is_relative_to(path)) or _is_held(path):
        return
    try:
        # Renamed first: on Windows this fails as a whole if a file is in use, where removing would stop half-way.
        trash = path.rename(path.with_name(f"{partial_prefix(folder)}{path.name}"))
    except OSError:
        return
    shutil.rmtree(trash, ignore_errors=True)


def _loaded_torch() -> str | None:
    return getattr(sys.modules.get("torch"), "__file__", None)


def _is_held(folder: Path) -> bool:
    """Whether any process uses the package in a folder."""
    if not has_package(folder):
        return False
    file = open_shared(_package_in(folder))
    if file is None:
        return True
    with file:
        return not lock_exclusively(file)


def switch_to(partial: Path, folder: Path) -> Path:
    """Makes a folder of packages the current installation and returns its new path."""
    before = installed(folder)
    numbered = (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2))
    if not has_package(folder):
        shutil.rmtree(folder, ignore_errors=True)  # what is there is no package
    target = next(path for path in itertools.chain([folder], numbered) if not os.path.lexists(path))
    partial.rename(target)
    pointer = folder.parent / f"{folder.name}{_POINTER}"
    if target == folder:
        pointer.unlink(missing_ok=True)
    else:
        written = pointer.with_name(f"{pointer.name}.part")
        written.write_text(target.name, encoding="utf-8")
        written.replace(pointer)
    if before is not None:
        _discard(before, folder)
    return target
