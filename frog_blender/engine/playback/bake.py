"""Baked playback: frames of a scene in a file, so that showing them needs no network.

A safetensors file with one tensor, a row for each time: the changing columns of the dynamic Gaussians (see
moving_part), one column after the other.  It names the scene file it was made from by a hash.  Rows are read one by one
instead of being mapped into memory: a mapped file that another program cuts short would end Blender.
"""

import hashlib
import json
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace
from io import FileIO
from pathlib import Path

from ..arrays import Array
from ..errors import FrogError, in_words
from ..io.plain_values import UnfitValue, items, number, plain_json
from ..io.regular_file import regular_file
from ..io.tensor_files import opened_tensors, read_header, write_rows
from ..scene.scene_file import FrameRows, RowLayout, stamp_of
from .frame_delta import FrameDelta
from .player import ScenePlayer

SUFFIX = ".frogbake"
_TENSOR, _KIND = "moments", "a bake of a .frog scene"
_MOST_TIMES = 1 << 24


def write_bake(path: Path, source: Path, scene: ScenePlayer, times: Sequence[float]) -> Generator[int, None, None]:
    """Bakes ``times``; yields how many are done. The file appears when all are.

    Closing the iterator before its end leaves nothing behind.

    Args:
        path: of the bake.
        source: the .frog file that ``scene`` was read from.
        times: in [0, 1], each once.

    Raises:
        FrogError: the disk is full, the folder cannot be written, or ``source`` changed meanwhile.
    """
    identity = fingerprint(source)
    metadata = {"scene": identity, "columns": json.dumps(scene.changing), "times": json.dumps(list(times))}
    layout = RowLayout(scene.num_dynamic, scene.changing)

    def rows() -> Iterator[Array]:
        for time in times:
            yield layout.packed(scene.delta_at(time))
        if fingerprint(source) != identity:
            raise FrogError(f"{source}: found another version of it than when baking began; bake again.")

    yield from write_rows(path, {}, metadata, (_TENSOR, "F32", (len(times), scene.delta_bytes // 4)), rows())


class Bake:
    """The frames of a bake; safe to use from any thread.

    Args:
        path: the file.
        source, scene: the .frog file it has to belong to, and what was read from it.

    Attributes:
        bytes: of the file.
        problem: a sentence once reading has failed; empty before.

    Raises:
        FrogError: damaged, of another kind, or made from another version of the scene.
    """

    def __init__(self, path: Path, source: Path, scene: ScenePlayer) -> None:
        self.problem = ""
        layout = RowLayout(scene.num_dynamic, scene.changing)
        with opened_tensors(path, _KIND) as file:
            begin, times, identity = _read_header(file, layout)
        if identity != fingerprint(source):
            message = f"{path}: found a bake of another version of {source.name}, expected one of the present; "
            raise FrogError(f"{message}bake again or clear it.")
        self._rows = FrameRows(path, stamp_of(path), begin, len(times), layout)
        self._places = {time: index for index, time in enumerate(times)}

    def __len__(self) -> int:
        """Baked times."""
        return len(self._places)

    @property
    def bytes(self) -> int:
        return self._rows.stamp[1]

    def find(self, time: float, rows: Array | None = None) -> FrameDelta | None:
        """What was baked of a time in [0, 1], bit for bit as computed; None where it was not, or cannot be read.

        Args:
            rows: (K,) indices of the wanted dynamic Gaussians, ascending; None for all of them.
        """
        index = self._places.get(time)
        if index is None or self.problem:
            return None
        try:
            return replace(self._rows, kept=rows).at(index)
        except FrogError:
            path = self._rows.path
            self.problem = f"{path}: the bake was changed or cannot be read any more; frames are computed instead."
            return None


def _read_header(file: FileIO, layout: RowLayout) -> tuple[int, list[float], str]:
    """Where the rows begin, their times and the scene's fingerprint."""
    tensors, metadata = read_header(file)
    if tensors.keys() != {_TENSOR} or "scene" not in metadata:
        raise UnfitValue("other arrays or texts", "those of a bake")
    tensor = tensors[_TENSOR]
    said = (plain_json(metadata.get(name, ""), name) for name in ("times", "columns"))
    times, columns = (items(value, "times or columns", _MOST_TIMES) for value in said)
    if tensor.dtype != "F32" or len(tensor.shape) != 2 or tensor.shape[0] != len(times):
        raise UnfitValue(f"{len(times)} times of {tensor.shape} numbers", "a row of floats for each")
    if 4 * tensor.shape[1] != layout.size or columns != list(layout.columns):
        return 0, [], ""  # another scene's
    return tensor.begin, [number(time, "a time", 0, 1) for time in times], metadata["scene"]


def fingerprint(path: Path) -> str:
    """Of a file's content; FrogError if it cannot be read."""
    unreadable = in_words(f"{path}: found a file that cannot be read", ", expected a .frog scene.")
    with unreadable, regular_file(path, "a .frog scene").open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=20)).hexdigest()
