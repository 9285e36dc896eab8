"""Computed frames in a bounded amount of memory: a least-recently-used cache."""

from __future__ import annotations

import threading
from collections import OrderedDict

from .frame_delta import FrameDelta

Key = tuple[str, float]
"""A scene's token and a time."""


class FrameCache:
    """Safe to use from any thread.

    Args:
        limit: bytes that all frames together may take.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._parts: OrderedDict[Key, FrameDelta] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def limit(self) -> int:
        """Bytes; a lower one takes effect at once."""
        return self._limit

    @limit.setter
    def limit(self, limit: int) -> None:
        with self._lock:
            self._limit = limit
            self._make_room(0)

    @property
    def bytes(self) -> int:
        """Bytes that the frames take."""
        return self._bytes

    def __len__(self) -> int:
        """Frames that are kept."""
        return len(self._parts)

    def __contains__(self, key: Key) -> bool:
        return key in self._parts

    def find(self, key: Key) -> FrameDelta | None:
        """What is kept of a time, which becomes the most recently used; None if there is nothing."""
        with self._lock:
            part = self._parts.get(key)
            if part is not None:
                self._parts.move_to_end(key)
            return part

    def keep(self, key: Key, part: FrameDelta) -> None:
        """Keeps a frame, dropping others for it; one that is larger than the limit is not kept."""
        with self._lock:
            self._bytes -= self._parts.pop(key).bytes if key in self._parts else 0
            if not 0 < part.bytes <= self._limit:
                return  # a static scene has nothing to keep
            self._make_room(part.bytes)
            self._parts[key] = part
            self._bytes += part.bytes

    def forget(self, token: str | None = None) -> None:
        """Drops the frames of a scene, of all scenes for None."""
        with self._lock:
            for key in [key for key in self._parts if token is None or key[0] == token]:
                self._bytes -= self._parts.pop(key).bytes

    def _make_room(self, wanted: int) -> None:
        while self._parts and self._bytes + wanted > self._limit:
            self._bytes -= self._parts.popitem(last=False)[1].bytes
