"""When groups of Gaussians are visible: playback does not deform invisible ones. No torch.

Fast motion is made of transient Gaussians, which FRoG's opacity reduction makes transparent at all other times. Masks
of active Gaussians between key frames are 4DGS-1K's (Yuan et al., arXiv 2503.16422). Here a mask is of a group, the
native library's unit of work, and of the interval between two frames; it leaves out only what no image shows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import Array
from ..capture.time import frame_to_time, time_to_frame
from ..native.options import ALPHA_MIN
from .simd_layout import GROUP_SIZE, num_groups

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
