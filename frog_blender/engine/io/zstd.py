"""Zstandard by the ``zstandard`` package, which Blender brings along from 5.3 on: streams whose sizes are known."""

from __future__ import annotations

import io
from typing import Any

_SMALLEST_WINDOW = 1 << 23  # bytes, which every decoder of the format has to have
_LEVEL = 12


def compressed(content: bytes) -> bytes:
    """A frame that says how long its content is.

    Raises:
        ImportError: where there is no ``zstandard``.
    """
    result: bytes = _library().ZstdCompressor(level=_LEVEL).compress(content)
    return result


def expanded(stream: bytes | memoryview, size: int) -> bytes:
    """The content of one frame, which has to be ``size`` bytes; no more memory is taken than that and a window.

    Raises:
        ImportError: where there is no ``zstandard``.
        ValueError: for a damaged stream, or one of another size.
    """
    library = _library()
    window = max(_SMALLEST_WINDOW, 1 << (size - 1).bit_length())
    try:
        reader = library.ZstdDecompressor(max_window_size=window).stream_reader(io.BytesIO(stream))
        content: bytes = reader.read(size + 1)
    except library.ZstdError as error:
        raise ValueError(str(error)) from error
    if len(content) != size:
        raise ValueError(f"{len(content):,} bytes at least, where {size:,} are announced")
    return content


def _library() -> Any:  # of a package that not everybody has
    import zstandard

    return zstandard
