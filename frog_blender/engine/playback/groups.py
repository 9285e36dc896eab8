"""Deformed Gaussians in groups: how they lie in memory at playback, and when they are visible. No torch.

Groups lie side by side, each in one piece: the native library works on whole vectors of Gaussians, from the embeddings
to the deformed attributes. Invisible groups are not deformed.

Fast motion is made of transient Gaussians, which FRoG's opacity reduction makes transparent at all other times. Masks
of active Gaussians between key frames are 4DGS-1K's (Yuan et al., arXiv 2503.16422). Here a mask is of a group, the
native library's unit of work, and of the interval between two frames; it leaves out only what no image shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..arrays import Array, NetworkArrays, SceneArrays
from ..capture.time import frame_to_time, time_to_frame
from ..native.options import ALPHA_MIN

GROUP_SIZE = 16
"""Gaussians side by side; GROUP_SIZE of the native library."""
_ROWS_AT_ONCE = GROUP_SIZE * 4096  # Gaussians that are multiplied at once, which bounds the temporary arrays
_ATTRIBUTES = ("means", "opacity_logits", "sh", "log_scales", "quaternions")  # last what does not change of all


def num_groups(count: int) -> int:
    """Groups that ``count`` Gaussians fill, the last of them perhaps not whole."""
    return -(-count // GROUP_SIZE)


def pack_lanes(arrays: SceneArrays, precomputed_first_layer: bool, *, rows_at_once: int = _ROWS_AT_ONCE) -> Array:
    """(ceil(N / GROUP_SIZE), rows, GROUP_SIZE) float32: each Gaussian's attributes and embedding as rows, a group's
    Gaussians as columns, zero beyond the last one.

    Args:
        arrays: ``means`` (N, 3), ``log_scales`` (N, 3), ``quaternions`` (N, 4), ``opacity_logits`` (N,), ``sh``
            (N, deformed coefficients, 3), ``embeddings`` (N, E) and ``embedding_weight`` (units, E).
        precomputed_first_layer: whether the embeddings' products with their weight stand in their place.
        rows_at_once: Gaussians that are packed at a time, a multiple of GROUP_SIZE; decides memory, not the result.
    """
    count, weight = len(arrays["means"]), arrays["embedding_weight"]
    columns = [arrays[name].reshape(count, math.prod(arrays[name].shape[1:])) for name in _ATTRIBUTES]
    width = sum(column.shape[1] for column in columns)
    own = len(weight) if precomputed_first_layer else weight.shape[1]
    result = np.zeros((num_groups(count), width + own, GROUP_SIZE), np.float32)
    for start in range(0, count, rows_at_once):
        some = slice(start, start + rows_at_once)
        embeddings = arrays["embeddings"][some]
        own_columns = embeddings @ weight.T if precomputed_first_layer else embeddings
        row = 0
        for column in [*(column[some] for column in columns), own_columns]:
            _put(column, result[start // GROUP_SIZE :, row : row + column.shape[1]])
            row += column.shape[1]
    return result


def _put(column: Array, rows: Array) -> None:
    """Writes (N, width) to the first of (groups, width, GROUP_SIZE)."""
    groups, rest = divmod(len(column), GROUP_SIZE)
    rows[:groups] = column[: groups * GROUP_SIZE].reshape(groups, GROUP_SIZE, column.shape[1]).transpose(0, 2, 1)
    if rest:
        rows[groups, :, :rest] = column[groups * GROUP_SIZE :].T


def transpose_weights(arrays: NetworkArrays) -> NetworkArrays:
    """The weights of the first layer and of the outputs, transposed, their rows padded to a multiple of GROUP_SIZE.

    Args:
        arrays: ``shared`` (units,), ``embedding_weight`` (units, E), ``output_weight`` (outputs, units) and
            ``output_bias`` (outputs,), and perhaps ``temporal_weight`` and ``modulation_weight`` (units, ...).
    """
    outputs = [slice(3), slice(10, None), slice(3, 10)]  # means; opacity and colours; scales and quaternions
    result: NetworkArrays = {}
    for name in ("shared", "embedding_weight", "temporal_weight", "modulation_weight", "output_weight", "output_bias"):
        if name in arrays:
            rows = arrays[name]
            if name.startswith("output"):
                rows = np.concatenate([rows[some] for some in outputs])
            padding = [(0, -len(rows) % GROUP_SIZE), *[(0, 0)] * (rows.ndim - 1)]
            result[name] = np.ascontiguousarray(np.pad(rows, padding).T, np.float32)
    return result


_SAMPLES = 4  # times from a frame to the next
_SEEN = 0.9 * ALPHA_MIN  # leaves a margin for times in between


def visible_intervals(opacities_at: Callable[[float], Array], frame_count: int) -> Array:
    """(frames - 1, M) bool: whether a Gaussian is visible at some time from a frame to the next, both included.

    Args:
        opacities_at: (M,) activated, at a time in [0, 1].
        frame_count: at least two.
    """

    def seen_at(frame: float) -> Array:
        return opacities_at(frame_to_time(frame, frame_count)) >= _SEEN

    at_frame, visible = seen_at(0), []
    for frame in range(1, frame_count):
        seen = at_frame
        for k in range(1, _SAMPLES):
            seen = seen | seen_at(frame - 1 + k / _SAMPLES)
        at_frame = seen_at(frame)
        visible.append(seen | at_frame)
    return np.stack(visible)


def sort_by_visibility(visible: Array) -> Array:
    """(M,) an order of Gaussians in which those visible at the same times are neighbours, of (frames - 1, M) bool."""
    result: Array = np.lexsort(visible[::-1])
    return result


def pack_group_bits(visible: Array) -> Array:
    """(frames - 1, groups / 8 rounded up) uint8: a bit for each group, set where one of its Gaussians is visible."""
    padded = np.pad(visible, ((0, 0), (0, -visible.shape[1] % GROUP_SIZE)))
    return np.packbits(padded.reshape(len(visible), -1, GROUP_SIZE).any(2), axis=1)


def mean_deformed_share(bits: Array, count: int) -> float:
    """The mean share of groups that are deformed at a time; bits of ``pack_group_bits`` for ``count`` Gaussians."""
    return float(np.unpackbits(bits, axis=1, count=num_groups(count)).mean())


class VisibilityMask:
    """What ``pack_group_bits`` gave, for playback.

    Args:
        bits: from a file.
        count: deformed Gaussians.

    Raises:
        ValueError: for bits of another number of Gaussians.
    """

    def __init__(self, bits: Array, count: int) -> None:
        groups = num_groups(count)
        if bits.dtype != np.uint8 or bits.ndim != 2 or not len(bits) or bits.shape[1] != -(-groups // 8):
            raise ValueError(f"lifetimes of {groups} groups are {bits.dtype} of shape {bits.shape}")
        self._bits, self._groups = bits, groups

    def select(self, kept: Array) -> Array:
        """``pack_group_bits`` of some of the Gaussians; (n,) indices, ascending."""
        visible = np.unpackbits(self._bits, axis=1, count=self._groups).astype(bool)
        return pack_group_bits(visible[:, kept // GROUP_SIZE])

    def at(self, time: float) -> Array:
        """(groups,) uint8, zero where a group is invisible at a time in [0, 1]."""
        interval = min(int(time_to_frame(time, len(self._bits) + 1)), len(self._bits) - 1)
        return np.unpackbits(self._bits[interval], count=self._groups)
