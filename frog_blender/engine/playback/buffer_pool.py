"""Memory for the Gaussians of a frame, used again once nobody holds a frame's arrays any more.

Fresh memory costs a page fault every few kilobytes, and colours that do not deform need to be written only once.
"""

from __future__ import annotations

import threading

import numpy as np


class BufferPool:
    """Hands out the same arrays again and again, each time when the last holder of the time before is gone.

    Args:
        first: float32 arrays of a frame by name, as they are before anybody writes; who overwrites parts of them does
            so in every frame, or keeps among them what was written last.
        kept: frames to remember; what is handed out beyond them is forgotten, oldest first.
    """

    def __init__(self, first: dict[str, np.ndarray], kept: int = 6) -> None:
        self._first, self._kept, self._size = first, kept, 0
        self._layout: list[tuple[str, tuple[int, ...], int]] = []  # name, shape, first byte
        for name, array in first.items():
            self._layout.append((name, array.shape, self._size))
            self._size += 4 * array.size
        self._blocks: list[bytearray] = []
        self._lock = threading.Lock()

    def take(self) -> dict[str, np.ndarray]:
        """Arrays of one frame, whose values are those of an earlier frame or ``first``."""
        return self.acquire()[0]

    def acquire(self) -> tuple[dict[str, np.ndarray], dict[str, int]]:
        """The same, and where they lie, which takes longer to find out of each."""
        with self._lock:
            for block in self._blocks:
                try:
                    # Python refuses to resize what an array still shows. It costs nothing: no memory is given back.
                    block.append(block.pop())
                except BufferError:
                    continue
                return self._arrays(block)
            block = bytearray(self._size + 1)
            self._blocks = [*self._blocks, block][-self._kept :]
            arrays, addresses = self._arrays(block)
        for name, values in self._first.items():
            arrays[name][...] = values
        return arrays, addresses

    def _arrays(self, block: bytearray) -> tuple[dict[str, np.ndarray], dict[str, int]]:
        whole = np.frombuffer(block, np.uint8)  # the block cannot be resized while this or one that shows it lives
        arrays: dict[str, np.ndarray] = {}
        addresses, first = dict[str, int](), whole.__array_interface__["data"][0]
        for name, shape, start in self._layout:
            arrays[name] = np.ndarray(shape, np.float32, whole, start)
            addresses[name] = first + start
        return arrays, addresses
