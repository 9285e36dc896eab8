"""The folder of decoded frames: how large it may be, what lies in it, and what is deleted first.

A limit is a number of bytes or a share of the disk. ``$FROG_CACHE_LIMIT`` says it, else a file in the folder that
``frog cache --limit`` writes, else it is a quarter of the disk. What was used longest ago is deleted first; what
any process has open stays.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..capture.sharing import lock_exclusively, open_shared
from ..errors import FrogError, found_instead
from ..io.atomic_files import write_atomically
from ..io.plain_values import typed

INDEX = "index.json"
PARTIAL = ".partial-"
FORMAT = 6
"""Of the stores that this version writes and reads; others are deleted."""
_LIMIT, _USUAL_LIMIT = "limit.txt", "25%"
_LIMIT_VARIABLE = "FROG_CACHE_LIMIT"
_LONGEST_LIMIT = 100  # bytes of the file
_NAME = re.compile("[0-9a-f]{32}")  # of a store
_ABANDONED_AFTER = 3600.0  # seconds without a write after which a partial store belongs to a killed process
_UNITS = {"": 1.0, "B": 1.0, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}


@dataclass(frozen=True)
class Index:
    """What a store says of itself.

    Attributes:
        format: see FORMAT.
        capture: path of the capture.
        sources: size and modification time of each file of the capture.
        files: a checksum of the sizes of each file's tiles, by its name.
    """

    format: int
    capture: str
    sources: dict[str, list[int]]
    files: dict[str, int]


@dataclass(frozen=True)
class StoredFrames:
    """Decoded frames of a capture in the cache.

    Attributes:
        folder: where they lie.
        index: None where it cannot be read, or is another version's.
        size: bytes.
        used: when they were last opened, seconds since 1970.
    """

    folder: Path
    index: Index | None
    size: int
    used: float


def parse_limit(text: str, where: str) -> re.Match[str]:
    """A limit in its plain form, its number and its unit: "40 GB" and "25 %" are "40GB" and "25%".

    Raises:
        FrogError: if it is none; ``where`` says whose it is.
    """
    plain = re.sub(r"\s+", "", text).upper()
    parsed = re.fullmatch(r"(\d{1,15}(?:\.\d{1,9})?)(%|[KMGT]?B|)", plain)
    if parsed is None or (parsed[2] == "%" and not 0 < float(parsed[1]) <= 100):
        raise found_instead(where, repr(text), "a size such as 40GB or a share of the disk such as 25%")
    return parsed


def limit_of(cache: Path) -> tuple[int, str]:
    """The bytes that decoded frames may take, and who says so.

    Raises:
        FrogError: if what says so is no limit.
    """
    file = cache / _LIMIT
    if given := os.environ.get(_LIMIT_VARIABLE, ""):
        limit, source = parse_limit(given, _LIMIT_VARIABLE), f"by {_LIMIT_VARIABLE}"
    elif file.is_file() and file.stat().st_size <= _LONGEST_LIMIT:
        kept = file.read_text(encoding="utf-8", errors="replace")
        limit, source = parse_limit(kept, str(file)), "by frog cache --limit"
    else:
        limit, source = parse_limit(_USUAL_LIMIT, "the limit"), "of the disk"
    said = f"{limit[0]} {source}"
    if limit[2] == "%":
        existing = next(path for path in (cache, *cache.parents) if path.exists())
        return int(float(limit[1]) / 100 * shutil.disk_usage(existing).total), said
    return int(float(limit[1]) * _UNITS[limit[2]]), said


def set_limit(cache: Path, text: str) -> None:
    """Keeps a limit for all that use this folder; "default" forgets it.

    Raises:
        FrogError: if it is none, or cannot be written.
    """
    if text.strip().lower() == "default":
        with suppress(FileNotFoundError):
            (cache / _LIMIT).unlink()
        return
    write_atomically(cache / _LIMIT, parse_limit(text, "--limit")[0].encode())


def stored_frames(cache: Path) -> list[StoredFrames]:
    """What lies in the folder, used longest ago first; partial stores do not count."""
    stores = []
    for folder in _folders(cache):
        if PARTIAL not in folder.name:
            size, used = 0, 0.0
            with suppress(OSError):
                size = size_of(folder)
                used = (folder / INDEX).stat().st_mtime
            stores.append(StoredFrames(folder, read_index(folder), size, used))
    return sorted(stores, key=lambda entry: entry.used)


def clear(cache: Path) -> tuple[int, int]:
    """Deletes all decoded frames that nobody uses: (bytes that were freed, stores that stay because they are open)."""
    remove_abandoned(cache)
    entries = stored_frames(cache)
    gone = [entry.size for entry in entries if remove_store(entry.folder)]
    return sum(gone), len(entries) - len(gone)


def make_room(cache: Path, size: int = 0, written: int = 0, spare: int = 0) -> None:
    """Deletes what was used longest ago until ``size`` more bytes fit under the limit and onto the disk, or nothing
    that can be deleted is left.

    Args:
        written: bytes of the store that is being written; it is none of those that can be deleted.
        spare: bytes that stay free on the disk.
    """
    limit, entries = limit_of(cache)[0], stored_frames(cache)
    total = sum(entry.size for entry in entries)
    for entry in entries:
        free = shutil.disk_usage(cache).free
        if total + size + written <= limit and free >= size + spare:
            return
        if remove_store(entry.folder):
            total -= entry.size


def remove_abandoned(cache: Path) -> None:
    """Deletes what killed processes left, and stores in formats of other versions that nobody has open."""
    for folder in _folders(cache):
        if PARTIAL in folder.name:
            with suppress(OSError):
                newest = max((file.stat().st_mtime for file in [folder, *folder.iterdir()]), default=0.0)
                if time.time() - newest > _ABANDONED_AFTER:
                    shutil.rmtree(folder, ignore_errors=True)
        elif read_index(folder) is None:
            remove_store(folder)


def remove_store(folder: Path) -> bool:
    """Deletes a store unless somebody has it open: whole, or not at all."""
    index = folder / INDEX
    if index.is_file():
        file = open_shared(index)
        if not lock_exclusively(file):
            if file is not None:
                file.close()
            return False
    gone = folder.with_name(f"{folder.name}{PARTIAL}{secrets.token_hex(4)}")
    try:
        folder.rename(gone)  # Windows refuses while a file of it is open
    except OSError:
        return False
    shutil.rmtree(gone, ignore_errors=True)
    return True


def size_of(folder: Path) -> int:
    """Bytes of a store. OSError if they cannot be counted."""
    return sum(file.stat().st_size for file in folder.iterdir())


def read_index(folder: Path) -> Index | None:
    """What a store says of itself; None where that cannot be read, or is another version's."""
    try:
        text = (folder / INDEX).read_text(encoding="utf-8")
        index: Index = typed(Index, json.loads(text), "an index")
    except (OSError, ValueError, RecursionError):
        return None
    return index if index.format == FORMAT else None


def _folders(cache: Path) -> Iterator[Path]:
    """The stores, whole and partial; nothing else that lies in the cache is this module's business."""
    try:
        entries = sorted(cache.iterdir())
    except OSError:
        return
    for entry in entries:
        name, _, _ = entry.name.partition(PARTIAL)
        if _NAME.fullmatch(name) and entry.is_dir() and not entry.is_symlink():
            yield entry


def keep_to_limit(cache: Path, needed: int) -> None:
    """Makes room for a store of ``needed`` bytes under the limit; FrogError if there is none."""
    make_room(cache, 0, needed)
    limit, said = limit_of(cache)
    others = sum(entry.size for entry in stored_frames(cache))
    if needed + others > limit:
        in_use = f" and {others / 1e9:.2f} GB are in use" if others else ""
        raise FrogError(
            f"{cache}: the decoded frames need about {needed / 1e9:.2f} GB, found a limit of {limit / 1e9:.2f} GB "
            f"({said}){in_use}: choose a smaller image scale, or a higher limit with frog cache --limit."
        )
