"""Output that may fail: a closed terminal or a full disk must not end a training."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO


@contextmanager
def printing_may_fail() -> Iterator[None]:
    """Inside the block output that cannot be printed is dropped without an error.

    The terminal may be closed, the pipe's reader gone, or the disk of a log full.
    """
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _LossyStream(sys.stdout), _LossyStream(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in before:
            _drop_buffer(stream)


class _LossyStream:
    """Wraps a text stream so that writing to it never raises."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):
            return self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:  # as the stream's own attributes
        return getattr(self._stream, name)


def _drop_buffer(stream: TextIO) -> None:
    """Flushes a stream; drops what cannot be written, which would else raise again when Python exits."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError), open(os.devnull, "w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())
