"""What the header of an MP4 or QuickTime file says of its film: when a player shows each frame, and its transfer curve.

Nothing is decoded. OpenCV counts times from the first frame that it decodes, and so does not say when a film starts.
(ISO/IEC 14496-12: boxes 8.6.1 ``stts`` and ``ctts``, 8.6.6 ``elst``, 12.1.5 ``colr``.)
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..arrays import Float64s
from .capture import MAX_FRAMES

_MAX_HEADER = 2**27  # bytes: films of many hours have less
_MAX_TOP_LEVEL = 10_000  # boxes before the header
_SAMPLE_ENTRY = 78  # bytes of a visual sample entry before the boxes in it
_TRANSFERS = {16: "pq", 18: "hlg"}  # ISO/IEC 23091-2
_EMPTY_EDIT = -1  # a media time: nothing is shown
_NORMAL_RATE = 0x10000  # 1.0, with 16 bits of fraction


@dataclass(frozen=True, eq=False)
class MovieHeader:
    """Of a file's first film.

    Attributes:
        timestamps: (N,) float64 ascending seconds, from the movie's start, of the frames that a player shows; None
            where the header does not say it plainly: films in fragments, or cut together from several parts.
        codec: four letters, such as "avc1".
        transfer: "hlg", "pq", or "" for every other curve; None where the header does not say it.
    """

    timestamps: Float64s | None
    codec: str
    transfer: str | None


class _Unfit(Exception):
    """The bytes are no such header."""


def read_movie_header(path: Path) -> MovieHeader | None:
    """None for other formats, for files without a film, and for damaged headers: OpenCV says what can be decoded."""
    try:
        with path.open("rb") as file:
            header = _header_box(file)
        return None if header is None else _movie(header)
    except (OSError, _Unfit, struct.error, ValueError, OverflowError):
        return None


def _header_box(file: BinaryIO) -> memoryview | None:
    """The payload of the box ``moov``; None where there is none."""
    length = file.seek(0, 2)
    place = 0
    for _ in range(_MAX_TOP_LEVEL):
        file.seek(place)
        start = file.read(16)
        if len(start) < 8:
            return None
        size, kind = struct.unpack(">I4s", start[:8])
        header = 8
        if size == 1:
            size, header = struct.unpack(">Q", start[8:16])[0], 16
        elif size == 0:
            size = length - place
        if not kind.isalnum() or size < header:
            return None
        if kind == b"moov":
            if size > min(_MAX_HEADER, length - place):
                return None
            file.seek(place + header)
            return memoryview(file.read(size - header))
        place += size
    return None


def _boxes(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Kind and payload of each box; what follows a damaged one is left out."""
    place = 0
    while place + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, place)
        header = 8
        if size == 1:
            size, header = struct.unpack_from(">Q", data, place + 8)[0], 16
        elif size == 0:
            size = len(data) - place
        if size < header or place + size > len(data):
            return
        yield kind, data[place + header : place + size]
        place += size


def _child(data: memoryview, *kinds: bytes) -> memoryview:
    """The payload of the first box of a kind within the first of another, and so on."""
    for kind in kinds:
        found = next((payload for name, payload in _boxes(data) if name == kind), None)
        if found is None:
            raise _Unfit
        data = found
    return data


def _has(data: memoryview, kind: bytes) -> bool:
    return any(name == kind for name, _ in _boxes(data))


def _movie(movie: memoryview) -> MovieHeader | None:
    for kind, track in _boxes(movie):
        if kind == b"trak" and bytes(_child(track, b"mdia", b"hdlr")[8:12]) == b"vide":
            codec, transfer = _look(_child(track, b"mdia", b"minf", b"stbl", b"stsd"))
            plain = not _has(movie, b"mvex")  # else it goes on in fragments
            return MovieHeader(_timestamps(movie, track) if plain else None, codec, transfer)
    return None


def _look(entries: memoryview) -> tuple[str, str | None]:
    """Codec and transfer of the first sample entry."""
    codec, entry = next(_boxes(entries[8:]), (b"", memoryview(b"")))
    transfer = None
    for kind, color in _boxes(entry[_SAMPLE_ENTRY:]):
        if kind == b"colr" and bytes(color[:4]) in (b"nclx", b"nclc") and len(color) >= 10:
            transfer = _TRANSFERS.get(struct.unpack_from(">H", color, 6)[0], "")
    return codec.decode("latin-1"), transfer


def _timestamps(movie: memoryview, track: memoryview) -> Float64s | None:
    """Seconds at which the track's frames are shown, those alone that its edit list shows."""
    try:
        scale = _time_scale(_child(track, b"mdia", b"mdhd"))
        shown = _shown(track, _time_scale(_child(movie, b"mvhd")), scale)
        table = _child(track, b"mdia", b"minf", b"stbl")
        times = _composition_times(table)
    except (_Unfit, struct.error, ValueError):
        return None
    if shown is None or not len(times):
        return None
    start, first, last = shown
    kept = np.sort(times[(times >= first) & (times < last)])
    return start + (kept - first) / scale if len(kept) else None


def _time_scale(box: memoryview) -> int:
    """Units in a second of ``mvhd`` or ``mdhd``."""
    scale: int = struct.unpack_from(">I", box, 20 if box[0] == 1 else 12)[0]
    if scale == 0:
        raise _Unfit
    return scale


def _shown(track: memoryview, movie_scale: int, scale: int) -> tuple[float, int, int] | None:
    """Seconds at which the film starts, and the media times from and up to which it is shown; None for several parts.

    Without an edit list all is shown, from media time 0 at the movie's start.
    """
    everything = 0.0, 0, 2**62
    edits = _edits(_child(track, b"edts", b"elst")) if _has(track, b"edts") else []
    if not edits:
        return everything
    *before, (duration, first, rate) = edits
    if first < 0 or rate != _NORMAL_RATE or any(media_time != _EMPTY_EDIT for _, media_time, _ in before):
        return None
    start = sum(empty for empty, _, _ in before) / movie_scale
    length = round(duration * scale / movie_scale) if duration else 2**61
    return start, first, first + length


def _edits(box: memoryview) -> list[tuple[int, int, int]]:
    """Duration in the movie's units, media time and rate of each edit."""
    entry = ">QqI" if box[0] == 1 else ">IiI"
    count = struct.unpack_from(">I", box, 4)[0]
    if count > 1000:
        raise _Unfit
    size = struct.calcsize(entry)
    return [struct.unpack_from(entry, box, 8 + size * index) for index in range(count)]


def _composition_times(table: memoryview) -> NDArray[np.int64]:
    """Media times at which the samples are shown, in the order of decoding."""
    durations = _expanded(_child(table, b"stts"), ">u4")
    times = np.concatenate([[0], np.cumsum(durations[:-1])]).astype(np.int64) if len(durations) else durations
    if _has(table, b"ctts"):
        delays = _expanded(_child(table, b"ctts"), ">i4")  # signed in version 0, too: so players read it
        if len(delays) != len(times):
            raise _Unfit
        times = times + delays
    return times


def _expanded(box: memoryview, kind: str) -> NDArray[np.int64]:
    """The values of a table of (count, value), each so many times."""
    count = struct.unpack_from(">I", box, 4)[0]
    if 8 + 8 * count > len(box):
        raise _Unfit
    counts = np.frombuffer(box, ">u4", 2 * count, 8)[::2].astype(np.int64)
    if counts.sum() > MAX_FRAMES:
        raise _Unfit
    return np.repeat(np.frombuffer(box, kind, 2 * count, 8)[1::2].astype(np.int64), counts)
