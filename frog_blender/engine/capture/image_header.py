"""What the first bytes of an image say: the size of PNG and JPEG, and whether a PNG or WebP has an alpha channel."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import found_instead

PNG_START = b"\x89PNG\r\n\x1a\n"
PNG_HEADER = 24  # bytes, up to and with the size
_PNG_ALPHA = frozenset({4, 6})  # colour types: brightness or colours, with alpha
_WEBP_ALPHA = 0x10  # of the flags
_JPEG_START = b"\xff\xd8"
# Start of a frame of any process; C4, C8 and CC among their numbers are something else.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD8)})


def size_in_header(file: BinaryIO) -> tuple[int, int] | None:
    """(width, height) as the first bytes of an open file say; None for other formats, and where they do not say it."""
    start = file.read(PNG_HEADER)
    size = png_size(start)
    if size is None and start.startswith(_JPEG_START):
        file.seek(len(_JPEG_START))
        size = _jpeg_size(file)
    return size


def has_alpha(path: Path) -> bool:
    """Whether an image file says that it has an alpha channel; of PNG and WebP, False for others.

    Raises:
        FrogError: if it cannot be read.
    """
    try:
        with path.open("rb") as file:
            start = file.read(PNG_HEADER + 2)
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "an image") from error
    if len(start) < PNG_HEADER + 2:
        return False
    if start.startswith(PNG_START):
        return start[PNG_HEADER + 1] in _PNG_ALPHA
    return start[:4] == b"RIFF" and start[8:16] == b"WEBPVP8X" and bool(start[20] & _WEBP_ALPHA)


def png_size(start: bytes) -> tuple[int, int] | None:
    """(width, height) from the first PNG_HEADER bytes of a PNG; None for what is none."""
    if len(start) < PNG_HEADER or not start.startswith(PNG_START):
        return None
    width, height = struct.unpack(">II", start[16:PNG_HEADER])
    return width, height


def is_cut_png(content: bytes) -> bool:
    """Whether a PNG has a chunk that says it is longer than the file: OpenCV makes room for as much as it says."""
    if not content.startswith(PNG_START):
        return False
    place = len(PNG_START)
    while place + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, place)
        if kind == b"IEND":
            return False
        place += 12 + length  # with the sum that follows
        if place > len(content):
            return True
    return False


def jpeg_segments(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Marker and length of each segment from the file's place on, with the file at its content."""
    while (marker := file.read(2)) and len(marker) == 2 and marker[0] == 0xFF:
        if marker[1] == 0xFF:  # padding: the next byte may be the marker's
            file.seek(-1, 1)
        elif marker[1] not in _JPEG_WITHOUT_LENGTH:
            head = file.read(2)
            if len(head) < 2 or (length := int.from_bytes(head, "big")) < 2:
                return
            content = file.tell()
            yield marker[1], length - 2
            file.seek(content + length - 2)


def _jpeg_size(file: BinaryIO) -> tuple[int, int] | None:
    """(width, height) from the segments that follow the file's first marker; None where they do not say it."""
    for marker, _ in jpeg_segments(file):
        if marker in _JPEG_FRAMES:
            head = file.read(5)
            if len(head) < 5:
                return None
            _, height, width = struct.unpack(">BHH", head)
            return width, height
    return None
