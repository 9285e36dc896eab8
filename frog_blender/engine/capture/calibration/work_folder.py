"""The hidden folder of a calibration's stages: each result is kept under a hash of all that decides it.

A hash of the arrays lies beside them: what is not as it was kept is done again.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...arrays import Array
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.numpy_files import read_npz
from ..readers.footage import state_of

NAME = ".frog_calibration"
"""The folder's name, beside the result."""
_VERSION = 2  # raise it when the same input would give another result
_MOST = 2**28  # numbers of one stage
_SEAL = "seal"


def key_of(*parts: object) -> str:
    """A hash of plain values and arrays."""
    digest = hashlib.blake2b(str(_VERSION).encode(), digest_size=12)
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype} {part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            digest.update(json.dumps(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()


def key_of_file(path: Path) -> list[object]:
    """What tells a file, or a folder of frames, from another one or an older one, for ``key_of``."""
    return state_of(path)


class WorkFolder:
    """Stages of earlier runs, by name and key."""

    def __init__(self, path: Path) -> None:
        """Args: path: the folder, made when the first stage is kept."""
        self.path = path

    def file(self, stage: str, key: str) -> Path:
        """Where a stage's result lies."""
        return self.path / f"{stage}-{key}.npz"

    def load(self, stage: str, key: str) -> dict[str, Array] | None:
        """The arrays of a stage; None where it was not kept, or its file is not as it was."""
        path = self.file(stage, key)
        if not path.is_file():
            return None
        try:
            arrays = read_npz(path, "a stage of a calibration", lambda name, shape: None, _MOST)
        except FrogError:
            return None
        seal = arrays.pop(_SEAL, None)
        return arrays if seal is not None and np.array_equal(seal, _seal(stage, arrays)) else None

    def keep(self, stage: str, key: str, arrays: Mapping[str, Array]) -> Path:
        """Writes a stage's arrays, whole or not at all; older results of the stage's name stay."""
        content = io.BytesIO()
        np.savez(content, **arrays, **{_SEAL: _seal(stage, arrays)})
        path = self.file(stage, key)
        write_atomically(path, content.getvalue())
        return path


def _seal(stage: str, arrays: Mapping[str, Array]) -> Array:
    """(12,) uint8 hash of a stage's arrays and their names."""
    parts = [part for name in sorted(arrays) for part in (name, arrays[name])]
    return np.frombuffer(bytes.fromhex(key_of(stage, *parts)), np.uint8)
