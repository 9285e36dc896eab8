"""Results on disk: JSON lines, one a run, that are only appended to, and the same as CSV; and what made a result."""

import csv
import gzip
import hashlib
import io
import json
import os
import platform
import re
import subprocess
import time
import zlib
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ..engine import FrogError, in_words, instruction_set, write_atomically

Record = dict[str, Any]


def append(path: Path, record: Record) -> None:
    """Appends a line in one write and flushes it to disk. Non-finite numbers, which JSON does not have, become None.

    A line that a killed process left half-written is ended first, so that it does not spoil the new one.
    """
    finite = json.loads(json.dumps(record), parse_constant=lambda _: None)
    line = json.dumps(finite, ensure_ascii=False) + "\n"
    with in_words(f"{path}: the results could not be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab+", buffering=0) as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    line = "\n" + line
            file.write(line.encode())
            os.fsync(file.fileno())


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
    with in_words(f"{path}: the results could not be read", kinds=(OSError, EOFError, zlib.error)):
        content = path.read_bytes() if path.exists() else b""
        return (gzip.decompress(content) if path.suffix == ".gz" else content).decode(errors="replace")


def finished(records: Iterable[Record]) -> dict[str, Record]:
    """The last finished run of each key."""
    return {record["key"]: record for record in records if record["kind"] == "run"}


def write_csv(folder: Path, records: Iterable[Record]) -> Path:
    """Writes ``runs.csv``: a line for each finished run, a column for each figure and setting (``recipe.steps``)."""
    lines = [_flat(record) for record in finished(records).values()]
    columns = dict.fromkeys(name for line in lines for name in line)
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    path = folder / "runs.csv"
    write_atomically(path, text.getvalue().encode())
    return path


def _flat(record: Record, prefix: str = "") -> Record:
    """The values of records within a record by names with dots; lists as JSON, None as nothing."""
    flat: Record = {}
    for name, value in record.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = json.dumps(value) if isinstance(value, list) else value
    return flat


@cache
def code() -> Record:
    """The code that makes results: the package's version, its commit (None where it is no clone; with ``+`` where files
    of it were changed), and a hash of its own files."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    sources = (".py", ".cpp", ".h", ".inl", ".cu", ".cuh")
    for file in sorted(file for file in package.rglob("*") if file.suffix in sources):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    release = None
    with suppress(PackageNotFoundError):
        release = version("frog_blender")
    commit = _git(package, "log", "-1", "--format=%H", "--", ".")
    changed = "+" if commit and _git(package, "status", "--porcelain", "--", ".") else ""
    return {"version": release, "commit": f"{commit}{changed}" if commit else None, "hash": digest.hexdigest()[:16]}


def _git(folder: Path, *arguments: str) -> str:
    """What git says of a folder; nothing where there is no git, or no clone."""
    with suppress(OSError, subprocess.SubprocessError):
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    return ""


def made_on() -> Record:
    """The part of a record that says on what, by which code and when it was made.

    Processor, cores, instruction set of the native library, GPU (None without one), versions, and ``code()``.
    """
    import torch

    kernels = cpu = None
    with suppress(FrogError):
        kernels = instruction_set()
    with suppress(OSError):
        cpu = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace"))
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    machine = {"cpu": cpu[1] if cpu else platform.processor() or platform.machine(), "cores": os.cpu_count() or 1}
    versions = {name: version(name) for name in ("torch", "numpy")} | {"python": platform.python_version()}
    return {
        "machine": {**machine, "instruction_set": kernels, "gpu": gpu},
        "versions": versions,
        "code": code(),
        "finished_at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
