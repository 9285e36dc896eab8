"""Frames that stay on the disk: a scene of the method SEQUENCE holds each frame's changing columns as one row.

The file is a ``.frog`` like any other, whose tensor ``frames`` (F, bytes of a row) is read row by row: however long a
sequence is, a frame of it is all that is held. A row is the columns that the header's model names (see
playback.frame_delta for their widths), one after the other, each of all dynamic Gaussians, which come first. They are
float32, or but for places float16.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import FrogError, found_instead
from ..io.plain_values import JsonObject, UnfitValue, items, text, whole
from ..io.tensor_files import opened_tensors, read_header
from .header import SceneHeader

FRAMES = "frames"
DYNAMIC, COLUMNS, KEEPS_IDENTITY, HALF = "dynamic", "columns", "keeps_identity", "half"
"""The model settings of a sequence: how many Gaussians change, the first ones; which columns of theirs do; whether the
same row is the same Gaussian in all frames, so that there is something between two frames; and whether all but places
are half floats."""
_KIND = "a .frog scene"
_WIDTHS = {"means": 3, "quaternions": 4, "scales": 3, "base": 4, **{f"sh_{k}": 3 for k in range(1, 16)}}
_LARGEST_HALF = 65504.0


@dataclass(frozen=True)
class RowLayout:
    """What a row is made of.

    Attributes:
        columns: names in their order.
        num_dynamic: Gaussians in each.
        half: whether all but places are half floats.
        keeps_identity: whether the same row is the same Gaussian in all frames.
    """

    columns: tuple[str, ...]
    num_dynamic: int
    half: bool
    keeps_identity: bool

    def kind(self, name: str) -> str:
        """A column's type."""
        return "<f2" if self.half and name != "means" else "<f4"

    @property
    def size(self) -> int:
        """Bytes of a row."""
        return self.num_dynamic * sum(_WIDTHS[name] * np.dtype(self.kind(name)).itemsize for name in self.columns)

    def model(self) -> JsonObject:
        """The header's model settings."""
        return {
            DYNAMIC: self.num_dynamic,
            COLUMNS: list(self.columns),
            KEEPS_IDENTITY: self.keeps_identity,
            HALF: self.half,
        }

    def packed(self, columns: dict[str, Array]) -> bytes:
        """A row of the columns' float32."""
        return b"".join(self._bytes(columns[name], self.kind(name)) for name in self.columns)

    @staticmethod
    def _bytes(column: Array, kind: str) -> bytes:
        bounded = column.clip(-_LARGEST_HALF, _LARGEST_HALF) if kind == "<f2" else column
        return np.ascontiguousarray(bounded, kind).tobytes()

    @classmethod
    def of(cls, header: SceneHeader, num_gaussians: int) -> RowLayout:
        """The layout that a sequence's header describes; UnfitValue for a header that describes none."""
        model = header.model
        columns = tuple(text(name, "a column", 16) for name in items(model.get(COLUMNS), COLUMNS, len(_WIDTHS)))
        if len(set(columns)) != len(columns) or not set(columns) <= _WIDTHS.keys():
            raise UnfitValue(f"the columns {', '.join(columns)}", f"some of {', '.join(_WIDTHS)}")
        keeps, half = (model.get(name) for name in (KEEPS_IDENTITY, HALF))
        if not isinstance(keeps, bool) or not isinstance(half, bool):
            raise UnfitValue(f"{KEEPS_IDENTITY} = {keeps!r}, {HALF} = {half!r}", "true or false")
        return cls(columns, whole(model.get(DYNAMIC), DYNAMIC, 0, num_gaussians), half, keeps)


@dataclass(frozen=True)
class FrameRows:
    """The rows of an open sequence; safe to use from any thread.

    Attributes:
        path: of the file, which is opened for each row: nothing is kept from replacing it.
        stamp: its modification time and size when it was found.
        begin: first byte of the first row.
        count: rows.
        layout: what they are made of.
        kept: (M,) which of their Gaussians are wanted, ascending; None for all.
    """

    path: Path
    stamp: tuple[int, int]
    begin: int
    count: int
    layout: RowLayout
    kept: Array | None = None

    def __len__(self) -> int:
        """Dynamic Gaussians that are wanted."""
        return self.layout.num_dynamic if self.kept is None else len(self.kept)

    def subset(self, kept: Array) -> FrameRows:
        """Rows of some of the scene's Gaussians.

        Args:
            kept: (K,) indices of those wanted now, ascending; static ones among them are passed over.
        """
        dynamic = kept[kept < len(self)]
        return replace(self, kept=dynamic if self.kept is None else self.kept[dynamic])

    def at(self, frame: int) -> dict[str, Array]:
        """(M, width) float32 by column of a frame; FrogError where the file was changed or cannot be read."""
        layout, size = self.layout, self.layout.size
        try:
            with self.path.open("rb", buffering=0) as file:
                if _stamp(self.path) != self.stamp:
                    raise found_instead(self.path, "another version of it than was opened", "the same; open it again")
                file.seek(self.begin + frame * size)
                content = file.read(size)
        except OSError as error:
            raise FrogError(f"{self.path}: a frame could not be read ({error.strerror or error}).") from error
        if len(content) != size:
            raise found_instead(self.path, f"{len(content):,} bytes of frame {frame}", f"{size:,}")
        found, start = {}, 0
        for name in layout.columns:
            shape = layout.num_dynamic, _WIDTHS[name]
            column = np.frombuffer(content, layout.kind(name), shape[0] * shape[1], start).reshape(shape)
            start += column.nbytes
            found[name] = (column if self.kept is None else column[self.kept]).astype(np.float32)
        return found


def find_rows(path: str | Path, header: SceneHeader, num_gaussians: int) -> FrameRows:
    """The rows of a sequence's file. UnfitValue or FrogError for a file that does not hold what its header says."""
    path, layout = Path(path), RowLayout.of(header, num_gaussians)
    with opened_tensors(path, _KIND) as file:
        tensor = read_header(file)[0].get(FRAMES)
    expected = (header.frame_count, layout.size)
    if tensor is None or tensor.shape != expected or tensor.dtype != "U8":
        found = f"shape {tensor.shape} and type {tensor.dtype}" if tensor else "nothing"
        raise UnfitValue(f"{FRAMES} of {found}", f"shape {expected} of bytes")
    return FrameRows(path, _stamp(path), tensor.begin, header.frame_count, layout)


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size
