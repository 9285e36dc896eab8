"""Results on disk: a file of JSON lines, one a run, that is only appended to."""

from __future__ import annotations

import gzip
import json
import math
import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..engine import FrogError

Record = dict[str, Any]


def append(path: Path, record: Record) -> None:
    """Appends a line in one write and flushes it to disk.

    A line that a killed process left half-written is ended first, so that it does not spoil the new one.
    """
    line = json.dumps(finite(record), allow_nan=False, ensure_ascii=False) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o644)
        try:
            size = os.lseek(handle, 0, os.SEEK_END)
            if size:
                os.lseek(handle, size - 1, os.SEEK_SET)
                if os.read(handle, 1) != b"\n":
                    line = "\n" + line
            os.write(handle, line.encode())
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        raise FrogError(f"{path}: the results could not be written ({error.strerror or error}).") from error


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds a lock file inside the block; the system releases it when the process ends.

    Without such locks (Windows) nothing is held.

    Raises:
        FrogError: if another process holds it.
    """
    try:
        import fcntl
    except ModuleNotFoundError:
        yield
        return
    try:
        file = path.open("w")
    except OSError as error:
        raise FrogError(f"{path}: could not be written ({error.strerror or error}).") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise FrogError(f"{path}: another process is working on these results.") from None
        yield


def read(path: Path) -> list[Record]:
    """Every whole line, in order; what is no JSON object is left out. No file is no results.

    Lines of ``path`` with ``.gz`` after its name, results that are kept compressed, come before those of ``path``.
    """
    records = []
    for line in (_text(path.with_name(path.name + ".gz")) + _text(path)).splitlines():
        try:
            record = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(record, dict) and "kind" in record:
            records.append(record)
    return records


def _text(path: Path) -> str:
    """What a file says, decompressed where its name ends in ``.gz``; nothing where there is none."""
    try:
        content = path.read_bytes()
        if path.suffix == ".gz":
            content = gzip.decompress(content)
    except FileNotFoundError:
        return ""
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise FrogError(f"{path}: the results could not be read ({reason}).") from error
    return content.decode(errors="replace")


def finished(records: Iterable[Record]) -> dict[str, Record]:
    """The last finished run of each key."""
    return {record["key"]: record for record in records if record["kind"] == "run"}


def timings(records: Iterable[Record], same: Sequence[str]) -> dict[tuple[Any, ...], Record]:
    """The last timing by the fields ``same``."""
    return {tuple(record[name] for name in same): record for record in records if record["kind"] == "timing"}


def finite(value: Any) -> Any:
    """The value with None for non-finite numbers, which JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
