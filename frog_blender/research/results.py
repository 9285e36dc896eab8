"""Results on disk: a file of JSON lines, one a run, that is only appended to; and what a result was made on."""

import gzip
import json
import os
import platform
import re
import time
import zlib
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..engine import FrogError, in_words, instruction_set

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


def made_on() -> Record:
    """The part of a record that says on what and when it was made.

    Processor, cores, instruction set of the native library, GPU (None without one), and versions.
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
        "finished_at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
