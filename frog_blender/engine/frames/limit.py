"""The folder of decoded frames: how large it may be, what lies in it, and what is deleted first.

A limit is a number of bytes or a share of the disk. ``$FROG_CACHE_LIMIT`` says it, else a file in the folder that
``frog cache --limit`` writes, else it is a quarter of the disk. What was used longest ago is deleted first; what
any process has open stays. The folder may hold anything else: a store is known by its index, and nothing is deleted
that holds any other file.
"""

import os
import re
import secrets
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..capture.sharing import lock_exclusively, open_shared
from ..errors import FrogError, found_instead
from ..io.atomic_files import write_atomically
from ..io.plain_values import UnfitValue, kept_json, typed

INDEX = "index.json"
PARTIAL = ".partial-"
FORMAT = 7
"""Of the stores that this version writes and reads; others are deleted."""
_LIMIT, _USUAL_LIMIT = "limit.txt", "25%"
_LIMIT_VARIABLE = "FROG_CACHE_LIMIT"
_LONGEST_LIMIT = 100  # bytes of the file
_NAME = re.compile("[0-9a-f]{32}")  # of a store
_FILES = re.compile(r"index\.json|damaged|[a-z]+\.(tiles|sizes)|seeds-[0-9a-f]+\.npz|\..+\.part")  # of any version's
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
    """What lies in the folder, used longest ago first, whole or in part."""
    stores = []
    for folder in cache.glob("*"):
        is_named = _NAME.fullmatch(folder.name.partition(PARTIAL)[0])
        if is_named and {"format", "sources"} <= kept_json(folder / INDEX).keys() and _holds_frames_alone(folder):
            with suppress(OSError):  # it was deleted meanwhile
                used = (folder / INDEX).stat().st_mtime
                stores.append(StoredFrames(folder, read_index(folder), size_of(folder), used))
    return sorted(stores, key=lambda entry: entry.used)


def clear(cache: Path) -> tuple[int, int]:
    """Deletes all decoded frames that nobody uses: (bytes that were freed, stores that stay because they are open)."""
    entries = stored_frames(cache)
    gone = [entry.size for entry in entries if remove_store(entry.folder)]
    return sum(gone), len(entries) - len(gone)


def make_room(cache: Path, size: int = 0, spare: int = 0) -> None:
    """Deletes what was used longest ago until ``size`` more bytes fit under the limit and onto the disk, or nothing
    that can be deleted is left. ``spare`` bytes stay free on the disk.
    """
    limit, entries = limit_of(cache)[0], stored_frames(cache)
    total = sum(entry.size for entry in entries)
    for entry in entries:
        free = shutil.disk_usage(cache).free
        if total + size <= limit and free >= size + spare:
            return
        if remove_store(entry.folder):
            total -= entry.size


def remove_store(folder: Path, even_open: bool = False) -> bool:
    """Deletes a store unless somebody has it open, or it holds a file of others: whole, or not at all."""
    if not _holds_frames_alone(folder):
        return False
    index = folder / INDEX
    gone = folder.with_name(f"{folder.name}{PARTIAL}{secrets.token_hex(4)}")
    try:
        if index.is_file() and not even_open:
            with open_shared(index) as file:
                if not lock_exclusively(file):
                    return False
        folder.rename(gone)  # Windows refuses while a file of it is open
    except OSError:
        return False
    with suppress(OSError):
        for path in sorted(gone.iterdir(), key=lambda path: path.name == INDEX):  # by which it is known, last
            path.unlink()
        gone.rmdir()
    return True


def size_of(folder: Path) -> int:
    """Bytes of a store. OSError if they cannot be counted."""
    return sum(file.stat().st_size for file in folder.iterdir())


def read_index(folder: Path) -> Index | None:
    """What a store says of itself; None where that cannot be read, or is another version's."""
    try:
        index: Index = typed(Index, kept_json(folder / INDEX), "an index")
    except UnfitValue:
        return None
    return index if index.format == FORMAT else None


def _holds_frames_alone(folder: Path) -> bool:
    try:
        with os.scandir(folder) as entries:
            ours = all(entry.is_file(follow_symlinks=False) and _FILES.fullmatch(entry.name) for entry in entries)
        return ours and not folder.is_symlink()
    except OSError:
        return False


def keep_to_limit(cache: Path, more: int, partial: Path | None = None) -> None:
    """Makes room under the limit for ``more`` bytes of a store of which a part may be written; FrogError if there is
    none."""
    make_room(cache, more)
    limit, said = limit_of(cache)
    needed = more + (0 if partial is None else size_of(partial))
    others = sum(entry.size for entry in stored_frames(cache) if partial is None or entry.folder.name != partial.name)
    if needed + others > limit:
        in_use = f" and {others / 1e9:.2f} GB are in use" if others else ""
        raise FrogError(
            f"{cache}: the decoded frames need about {needed / 1e9:.2f} GB, found a limit of {limit / 1e9:.2f} GB "
            f"({said}){in_use}: choose a smaller image scale, or a higher limit with frog cache --limit."
        )
