"""What EXIF says of a photograph: the tags that are asked for of an open JPEG, PNG or WebP.

An own parser, for it reads what strangers wrote: every length is limited, and what is cut short says nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import BinaryIO

from .image_header import PNG_START, jpeg_segments

ORIENTATION, MAKE, MODEL, FOCAL_LENGTH_35MM = 0x0112, 0x010F, 0x0110, 0xA405
_EXIF_MARKER, _EXIF_START = 0xE1, b"Exif\0\0"
_SHORT, _ASCII, _LONG = 3, 2, 4
_MORE = 0x8769  # the tag of a second directory, which tells how the image was taken
_MAX_ENTRIES, _MAX_CHUNKS, _MAX_EXIF, _MAX_TEXT = 1000, 1000, 2**16, 200


def exif_tags(file: BinaryIO, wanted: Iterable[int]) -> dict[int, int | str]:
    """The values of those of the wanted tags that the file has, as a whole number or a text.

    Returns:
        Texts without what cannot be printed; no tag whose value is of another type.
    """
    found: dict[int, int | str] = {}
    try:
        exif = _exif(file).removeprefix(_EXIF_START)
        order = {b"II": "<", b"MM": ">"}.get(exif[:2])
        if order is None:
            return {}
        tags = {*wanted, _MORE}
        _read(exif, order, struct.unpack_from(f"{order}I", exif, 4)[0], tags, found)
        more = found.pop(_MORE, None)
        if isinstance(more, int):
            _read(exif, order, more, tags - {_MORE}, found)
    except struct.error:
        pass  # cut short: what was found before counts
    found.pop(_MORE, None)
    return found


def _exif(file: BinaryIO) -> bytes:
    start = file.read(12)
    file.seek(0)
    if start.startswith(b"\xff\xd8"):
        return _jpeg_exif(file)
    if start.startswith(PNG_START):
        return _png_exif(file)
    if start[:4] == b"RIFF" and start[8:] == b"WEBP":
        return _webp_exif(file)
    return b""


def _jpeg_exif(file: BinaryIO) -> bytes:
    file.seek(2)
    for marker, length in jpeg_segments(file):
        if marker == _EXIF_MARKER:
            content = file.read(length)
            if content.startswith(_EXIF_START):
                return content
    return b""


def _png_exif(file: BinaryIO) -> bytes:
    place = len(PNG_START)
    for _ in range(_MAX_CHUNKS):
        file.seek(place)
        size, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"eXIf":
            return file.read(min(size, _MAX_EXIF))
        if kind == b"IDAT":  # what follows the image is not looked for: it may have many chunks
            break
        place += 12 + size
    return b""


def _webp_exif(file: BinaryIO) -> bytes:
    place = 12
    for _ in range(_MAX_CHUNKS):
        file.seek(place)
        kind, size = struct.unpack("<4sI", file.read(8))
        if kind == b"EXIF":
            return file.read(min(size, _MAX_EXIF))
        place += 8 + size + size % 2
    return b""


def _read(exif: bytes, order: str, place: int, wanted: set[int], found: dict[int, int | str]) -> None:
    """Adds the wanted tags of one directory; of a tag that comes twice the first counts."""
    count = min(struct.unpack_from(f"{order}H", exif, place)[0], _MAX_ENTRIES)
    for start in range(place + 2, place + 2 + 12 * count, 12):
        tag, kind, length = struct.unpack_from(f"{order}HHI", exif, start)
        if tag not in wanted or tag in found:
            continue
        if kind == _SHORT:
            found[tag] = struct.unpack_from(f"{order}H", exif, start + 8)[0]
        elif kind == _LONG:
            found[tag] = struct.unpack_from(f"{order}I", exif, start + 8)[0]
        elif kind == _ASCII:
            at = start + 8 if length <= 4 else struct.unpack_from(f"{order}I", exif, start + 8)[0]
            text = exif[at : at + min(length, _MAX_TEXT)].split(b"\0")[0].decode("ascii", "ignore")
            found[tag] = "".join(letter for letter in text if letter.isprintable()).strip()
