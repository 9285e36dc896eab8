"""Memory for the arrays of a frame, reused once nobody holds any of them.

Fresh memory costs a page fault for every few kilobytes, and colours that do not deform need to be written only once.
"""

from __future__ import annotations

import weakref
from collections import deque

import numpy as np

from ..arrays import Array


class BufferPool:
    """Hands out the same memory again, each time when the last array of the time before is gone.

    Args:
        first: float32 arrays of a frame by name, as they are in new memory. A user writes the same parts of them in
            every frame, or keeps among them what was written last.
        kept: blocks of memory that may lie unused; of more, the oldest is freed.
    """

    def __init__(self, first: dict[str, Array], kept: int = 6) -> None:
        self._first, self._size = first, 0
        self._layout: list[tuple[str, tuple[int, ...], int]] = []  # name, shape, first byte
        for name, array in first.items():
            self._layout.append((name, array.shape, self._size))
            self._size += 4 * array.size
        # Without a lock: a block is given back in whatever thread drops its last array, even one that is in here.
        self._free: deque[bytearray] = deque(maxlen=kept)

    def __len__(self) -> int:
        """Blocks of memory that lie unused."""
        return len(self._free)

    def take(self) -> dict[str, Array]:
        """Arrays of one frame, with the values of an earlier frame or of ``first``."""
        return self.acquire()[0]

    def acquire(self) -> tuple[dict[str, Array], dict[str, int]]:
        """The same, and their addresses, which are cheaper to know here than to look up of each array."""
        try:
            return self._lease(self._free.pop())
        except IndexError:
            arrays, addresses = self._lease(bytearray(self._size + 1))  # never empty, which numpy refuses
        for name, values in self._first.items():
            arrays[name][...] = values
        return arrays, addresses

    def _lease(self, block: bytearray) -> tuple[dict[str, Array], dict[str, int]]:
        # Every array of the block, and every view of one, holds this object: numpy's views refer to the array whose
        # memory is no array's. When it dies the block is free.
        whole = np.frombuffer(block, np.uint8)
        weakref.finalize(whole, self._free.append, block).atexit = False
        arrays: dict[str, Array] = {}
        addresses, first = dict[str, int](), whole.__array_interface__["data"][0]
        for name, shape, start in self._layout:
            arrays[name] = np.ndarray(shape, np.float32, whole, start)
            addresses[name] = first + start
        return arrays, addresses
