"""When the film in a Matroska or WebM file starts, and its transfer curve. Nothing is decoded. (RFC 9559)"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_EBML, _SEGMENT = 0x1A45DFA3, 0x18538067
_INFO, _TIMESTAMP_SCALE = 0x1549A966, 0x2AD7B1
_TRACKS, _TRACK, _NUMBER, _TYPE, _VIDEO, _COLOUR, _TRANSFER = 0x1654AE6B, 0xAE, 0xD7, 0x83, 0xE0, 0x55B0, 0x55BA
_CLUSTER, _CLUSTER_TIME, _SIMPLE_BLOCK, _BLOCK_GROUP, _BLOCK = 0x1F43B675, 0xE7, 0xA3, 0xA0, 0xA1
_IS_VIDEO = 1
_MAX_ELEMENTS = 20_000  # read before the film's first block
_MAX_NUMBER = 8  # bytes of a whole number


@dataclass(frozen=True)
class MatroskaHeader:
    """Of a file's first film.

    Attributes:
        start: seconds from the file's start at which its first frame is shown.
        transfer: the number of its curve in ISO/IEC 23091-2; None where the file does not say it.
    """

    start: float
    transfer: int | None


@dataclass(frozen=True)
class _Element:
    """A part of the file: what it is, and where its content lies."""

    kind: int
    begin: int
    end: int


class _Unfit(Exception):
    """The bytes are no such file."""


class _Reader:
    """A file of nested elements, of which a bounded number is read."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._left = file, _MAX_ELEMENTS
        self.length = file.seek(0, 2)

    def children(self, begin: int, end: int) -> Iterator[_Element]:
        while begin < end:
            self._left -= 1
            if self._left < 0:
                raise _Unfit
            self._file.seek(begin)
            kind, size = self._variable(keep_marker=True), self._variable(keep_marker=False)
            content = self._file.tell()
            last = end if size is None else content + size
            if kind is None or last > end:
                raise _Unfit
            yield _Element(kind, content, last)
            begin = last

    def whole(self, element: _Element) -> int:
        """An element's whole number, at most so many bytes of it."""
        return int.from_bytes(self.content(element, _MAX_NUMBER), "big")

    def content(self, element: _Element, most: int) -> bytes:
        self._file.seek(element.begin)
        return self._file.read(min(element.end - element.begin, most))

    def _variable(self, *, keep_marker: bool) -> int | None:
        """A number of variable length, of 8 bytes at most; None for an unknown size."""
        first = self._file.read(1)
        if not first or not first[0]:
            raise _Unfit
        count = 9 - first[0].bit_length()
        rest = self._file.read(count - 1)
        if len(rest) < count - 1:
            raise _Unfit
        marker = 1 << (7 * count)
        value = int.from_bytes(first + rest, "big")
        if keep_marker:
            return value
        value -= marker
        return None if value == marker - 1 else value


def read_matroska_header(path: Path) -> MatroskaHeader | None:
    """None for other formats, for files without a film, and for damaged headers."""
    try:
        with path.open("rb") as file:
            return _header(_Reader(file))
    except (OSError, _Unfit, ValueError, OverflowError):
        return None


def _header(reader: _Reader) -> MatroskaHeader | None:
    top = reader.children(0, reader.length)
    first = next(top, None)
    if first is None or first.kind != _EBML:
        return None
    segment = next((element for element in top if element.kind == _SEGMENT), None)
    if segment is None:
        return None
    scale, film, transfer = 1_000_000, None, None  # nanoseconds in a unit of time
    for element in reader.children(segment.begin, segment.end):
        if element.kind == _INFO:
            for info in reader.children(element.begin, element.end):
                scale = reader.whole(info) if info.kind == _TIMESTAMP_SCALE else scale
        elif element.kind == _TRACKS and film is None:
            film, transfer = _film(reader, element)
        elif element.kind == _CLUSTER and film is not None:
            start = _first_block(reader, element, film)
            if start is not None:
                return MatroskaHeader(start * scale / 1e9, transfer)
    return None


def _film(reader: _Reader, tracks: _Element) -> tuple[int | None, int | None]:
    """Number and transfer of the first track that is a film."""
    for track in reader.children(tracks.begin, tracks.end):
        if track.kind != _TRACK:
            continue
        parts = {part.kind: part for part in reader.children(track.begin, track.end)}
        if _TYPE not in parts or _NUMBER not in parts or reader.whole(parts[_TYPE]) != _IS_VIDEO:
            continue
        within = parts.get(_VIDEO)
        for kind in (_COLOUR, _TRANSFER):
            inside = reader.children(within.begin, within.end) if within is not None else iter(())
            within = next((part for part in inside if part.kind == kind), None)
        return reader.whole(parts[_NUMBER]), None if within is None else reader.whole(within)
    return None, None


def _first_block(reader: _Reader, cluster: _Element, film: int) -> int | None:
    """Time of the film's first block in a cluster, in the file's units."""
    time = 0
    for element in reader.children(cluster.begin, cluster.end):
        block = element
        if element.kind == _CLUSTER_TIME:
            time = reader.whole(element)
        elif element.kind == _BLOCK_GROUP:
            inside = reader.children(element.begin, element.end)
            block = next((part for part in inside if part.kind == _BLOCK), element)
        if block.kind in (_SIMPLE_BLOCK, _BLOCK):
            head = reader.content(block, 3)
            if len(head) == 3 and head[0] == 0x80 | film:
                return time + int.from_bytes(head[1:], "big", signed=True)
    return None
