"""The YAML that OpenCV's FileStorage writes, and EasyMocap and EasyVolcap in its manner; nothing else of YAML.

``key: !!opencv-matrix`` with rows, cols, dt and data; ``key: number``; ``key:`` with a list of names, or in brackets.
An own reader: of what anybody may have written, sizes and types are checked here, and no other program's parser is
trusted with it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from .checks import check_length, number, numbers

_KEY = re.compile(r"(\"?)([^\s:\"#][^:\"]*)\1\s*:(?:\s+(.*))?$")
_FIELD = re.compile(r"^\s+(rows|cols|dt)\s*:\s*(\S+)\s*$", re.MULTILINE)
_DATA = re.compile(r"^\s+data\s*:\s*\[([^\]]*)\]", re.MULTILINE)
_MATRIX = "!!opencv-matrix"
_MOST_NUMBERS = 1000
_LONGEST = 2**24  # bytes: a camera takes a thousand


class OpencvYaml:
    """A file's values by key."""

    def __init__(self, path: Path) -> None:
        """Reads the file; FrogError where it is not such a file."""
        self.path = path
        check_length(path, "OpenCV's YAML")
        if path.stat().st_size > _LONGEST:
            raise found_instead(path, f"{path.stat().st_size:,} bytes", f"at most {_LONGEST:,}")
        try:
            text = path.read_text(encoding="utf-8-sig", errors="replace")
        except OSError as error:
            raise found_instead(path, f"a file that cannot be read ({error.strerror})", "OpenCV's YAML") from error
        self._blocks: dict[str, str] = {}
        key, lines = "", list[str]()
        for line in text.splitlines():
            match = None if line[:1] in ("", " ", "\t", "-", "%", "#", "]") else _KEY.match(line)
            if match is None:
                lines.append(line)
                continue
            self._close(key, lines)
            key, lines = match[2].strip(), [match[3] or ""]
        self._close(key, lines)
        if not self._blocks:
            raise found_instead(path, "no key with a value", "OpenCV's YAML (%YAML:1.0)")

    def _close(self, key: str, lines: list[str]) -> None:
        if key:
            self._blocks.setdefault(key, "\n".join(lines))

    @property
    def keys(self) -> list[str]:
        """In the order of the file."""
        return list(self._blocks)

    def __contains__(self, key: str) -> bool:
        return key in self._blocks

    def matrix(self, key: str) -> Float64s:
        """(rows, cols) numbers.

        Raises:
            FrogError: if the key is not there or no matrix of at most ``_MOST_NUMBERS`` finite numbers.
        """
        block = self._blocks.get(key)
        if block is None or not block.startswith(_MATRIX):
            raise found_instead(self.path, f"no matrix {key}", f"{key}: {_MATRIX}")
        fields, data = dict(_FIELD.findall(block)), _DATA.search(block)
        if data is None or not {"rows", "cols"} <= fields.keys():
            raise found_instead(self.path, f"a matrix {key} without rows, cols or data", "all three")
        shape = tuple(round(number(fields[side], self.path, f"{side} of {key}")) for side in ("rows", "cols"))
        values = [word for word in re.split(r"[\s,]+", data[1]) if word]
        if min(shape) < 1 or shape[0] * shape[1] != len(values) or len(values) > _MOST_NUMBERS:
            found = f"{len(values)} numbers in {key} of {shape[0]} x {shape[1]}"
            raise found_instead(self.path, found, f"as many as it has places, at most {_MOST_NUMBERS}")
        flat = numbers(values, (len(values),), self.path, key)
        return np.asarray(flat).reshape(shape)

    def number(self, key: str) -> float | None:
        """A number; None where the key is not there. FrogError for anything else."""
        block = self._blocks.get(key)
        return None if block is None else number(block.strip(), self.path, key)

    def names(self, key: str) -> list[str]:
        """A list of names; none where the key is not there."""
        block = self._blocks.get(key, "").strip()
        if block.startswith("["):
            found = block.strip("[] \n").split(",")
        else:
            found = [line.strip()[1:] for line in block.splitlines() if line.strip().startswith("-")]
        return [name for each in found if (name := each.strip().strip("\"'"))]
