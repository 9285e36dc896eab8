"""Arrays that an earlier run found, kept where the next one looks, under a hash of all that decides them."""

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import FrogError
from .atomic_files import write_atomically
from .numpy_files import read_npz

_VERSION = 5  # raise it when the same input would give another result
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


@dataclass(frozen=True)
class WorkFolder:
    """What earlier runs found, stage by stage, each under a hash of all that decides it; made when the first one is.

    A hash of the arrays lies beside them: what is not as it was kept is done again.
    """

    path: Path

    def file(self, stage: str, key: str) -> Path:
        """Where a stage's result lies."""
        return self.path / f"{stage}-{key}.npz"

    def load(self, stage: str, key: str) -> dict[str, Array] | None:
        """The arrays of a stage; None where it was not kept, or its file is not as it was."""
        path = self.file(stage, key)
        if not path.is_file():
            return None
        try:
            arrays = read_npz(path, "what an earlier run kept", _MOST)
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

    def kept(self, stage: str, key: str, make: Callable[[], Mapping[str, Array]]) -> Mapping[str, Array]:
        """A stage's arrays of an earlier run, or new ones, which are kept."""
        arrays: Mapping[str, Array] | None = self.load(stage, key)
        if arrays is None:
            arrays = make()
            self.keep(stage, key, arrays)
        return arrays


def _seal(stage: str, arrays: Mapping[str, Array]) -> Array:
    """(12,) uint8 hash of a stage's arrays and their names."""
    parts = [part for name in sorted(arrays) for part in (name, arrays[name])]
    return np.frombuffer(bytes.fromhex(key_of(stage, *parts)), np.uint8)
