"""The part of a frame that changes in time, memory for frames, and a bounded cache of them.

A frame's columns are ``means`` (N, 3), ``quaternions`` (N, 4), ``scales`` (N, 3), ``base`` (N, 4: the first SH
coefficient and the opacity) and ``sh_1`` ... (N, 3) of each further coefficient, float32 and contiguous.

Memory is used again once nobody holds any of it: fresh memory costs a page fault for every few kilobytes, and colours
that do not deform need to be written only once.
"""

import threading
import weakref
from collections import OrderedDict, deque
from typing import TypeAlias

import numpy as np

from ..arrays import Array, SceneArrays
from ..gaussians import GaussianArrays, NumpyGaussians
from ..scene.scene_file import WIDTHS

_UNUSED = 6  # blocks of memory that may lie unused; of more, the oldest is freed


class BufferPool:
    """Hands out the same memory again, each time when the last array of the time before is gone.

    Args:
        first: float32 arrays of a frame by name, as they are in new memory. A user writes the same parts of them in
            every frame, or keeps among them what was written last.
    """

    def __init__(self, first: dict[str, Array]) -> None:
        self._first, self._size = first, 0
        self._layout: list[tuple[str, tuple[int, ...], int]] = []  # name, shape, first byte
        for name, array in first.items():
            self._layout.append((name, array.shape, self._size))
            self._size += 4 * array.size
        # Without a lock: a block is given back in whatever thread drops its last array, even one that is in here.
        self._free: deque[memoryview] = deque(maxlen=_UNUSED)

    def take(self) -> tuple[dict[str, Array], dict[str, int]]:
        """Arrays of one frame, with the values of an earlier frame or of ``first``, and their addresses, which are
        cheaper to know here than to look up of each array."""
        try:
            return self._lease(self._free.pop())
        except IndexError:
            # Never empty, which numpy refuses. Python would keep all other threads waiting until it had filled it.
            arrays, addresses = self._lease(np.empty(self._size + 1, np.uint8).data)
        for name, values in self._first.items():
            arrays[name][...] = values
        return arrays, addresses

    def _lease(self, block: memoryview) -> tuple[dict[str, Array], dict[str, int]]:
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


def canonical_gaussians(arrays: SceneArrays) -> NumpyGaussians:
    """The canonical field of a scene file's arrays, activated, with unit quaternions."""
    opacities = 1 / (1 + np.exp(-np.clip(arrays["opacity_logits"], -80, 80)))
    scales = np.exp(np.clip(arrays["log_scales"], -80, 80))  # as the native library does
    return GaussianArrays(
        arrays["means"], normalize(arrays["quaternions"]), scales, opacities.astype(np.float32), arrays["sh"]
    )


def canonical_arrays(g: NumpyGaussians) -> SceneArrays:
    """The other way round: a static scene file's arrays, of Gaussians with unit quaternions."""
    opacities = np.clip(g.opacities.astype(np.float64), 1e-12, 1 - 2.0**-26)
    scales = np.maximum(g.scales.astype(np.float64), 1e-30)
    logits = np.log(opacities) - np.log1p(-opacities)
    arrays = {"means": g.means, "quaternions": g.quaternions, "log_scales": np.log(scales), "opacity_logits": logits}
    return {name: np.ascontiguousarray(array, np.float32) for name, array in (arrays | {"sh": g.sh}).items()}


def normalize(quaternions: Array) -> Array:
    """(N, 4) of length one."""
    return np.asarray(quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12))


def column_names(sh_count: int) -> tuple[str, ...]:
    """Every column of Gaussians with so many SH coefficients, in a fixed order."""
    return tuple(WIDTHS)[: 3 + sh_count]


FrameDelta: TypeAlias = dict[str, Array]
"""The changing columns (M, width) of the M dynamic Gaussians at one time, by name; not to be written to."""


def column_of(gaussians: NumpyGaussians, name: str, count: int | None = None) -> Array:
    """(count, width) contiguous: a column of the first ``count`` Gaussians, of all for None."""
    if name == "base":
        opacities = gaussians.opacities[:count]
        base = np.empty((len(opacities), 4), np.float32)
        base[:, :3], base[:, 3] = gaussians.sh[:count, 0], opacities
        return base
    if name.startswith("sh_"):
        return _coefficient(gaussians.sh[:count], int(name.removeprefix("sh_")))
    return np.ascontiguousarray(getattr(gaussians, name)[:count])


def put_columns(arrays: dict[str, Array], columns: dict[str, Array], count: int) -> None:
    """Puts columns of the first ``count`` Gaussians into arrays of all; one that has all of them takes its place."""
    for name, column in columns.items():
        if name == "base":
            arrays["sh"][:count, 0], arrays["opacities"][:count] = column[:, :3], column[:, 3]
        elif name.startswith("sh_"):
            arrays["sh"][:count, int(name.removeprefix("sh_"))] = column
        elif count < len(arrays[name]):
            arrays[name][:count] = column
        else:
            arrays[name] = column


def column_view(gaussians: NumpyGaussians, name: str) -> Array:
    """(N, width) a column to be read once: not a copy, but for ``base``."""
    if name.startswith("sh_"):
        return gaussians.sh[:, int(name.removeprefix("sh_"))]
    return column_of(gaussians, name)


def _coefficient(sh: Array, k: int) -> Array:
    """(N, 3) contiguous, of (N, K, 3)."""
    if sh.dtype != np.float32 or not sh.flags.c_contiguous:
        return np.ascontiguousarray(sh[:, k])
    whole = sh.view("V12")[:, :, 0]  # numpy copies one piece of 12 bytes in half the time of three numbers
    return np.ascontiguousarray(whole[:, k]).view(np.float32).reshape(-1, 3)


Key = tuple[str, float]
"""A scene's token and a time."""


class FrameCache:
    """Safe to use from any thread.

    Attributes:
        limit: bytes that all frames together may take.
        bytes: that they take.
    """

    def __init__(self, limit: int) -> None:
        self.limit, self.bytes = limit, 0
        self._parts: OrderedDict[Key, FrameDelta] = OrderedDict()
        self._lock = threading.Lock()

    def set_limit(self, limit: int) -> None:
        """Drops frames at once where that is less than they take."""
        with self._lock:
            self.limit = limit
            self._make_room(0)

    def __len__(self) -> int:
        """Frames that are kept."""
        return len(self._parts)

    def find(self, key: Key) -> FrameDelta | None:
        """What is kept of a time, which becomes the most recently used; None if there is nothing."""
        with self._lock:
            part = self._parts.get(key)
            if part is not None:
                self._parts.move_to_end(key)
            return part

    def keep(self, key: Key, part: FrameDelta) -> None:
        """Keeps a frame, dropping others for it; one that is larger than the limit is not kept."""
        size = _size(part)
        with self._lock:
            self.bytes -= _size(self._parts.pop(key, {}))
            if not 0 < size <= self.limit:
                return  # a static scene has nothing to keep
            self._make_room(size)
            self._parts[key] = part
            self.bytes += size

    def forget(self, token: str | None = None) -> None:
        """Drops the frames of a scene, of all scenes for None."""
        with self._lock:
            for key in [key for key in self._parts if token is None or key[0] == token]:
                self.bytes -= _size(self._parts.pop(key))

    def _make_room(self, size: int) -> None:
        while self._parts and self.bytes + size > self.limit:
            self.bytes -= _size(self._parts.popitem(last=False)[1])


def _size(part: FrameDelta) -> int:
    """Bytes."""
    return sum(column.nbytes for column in part.values())
