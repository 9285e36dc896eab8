"""When Gaussians can be seen at all: playback deforms no group of them while it is invisible. No torch.

What moves fast is made of Gaussians that are there for a few moments each, and FRoG's opacity reduction makes those
transparent at all others. Masks of what is active between key frames are 4DGS-1K's (Yuan et al., arXiv 2503.16422);
here a mask is of a group, which is what the native library works on, and of the time between two frames, and takes only
what no image of a frame shows anyway.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..capture.time import frame_to_time, time_to_frame
from ..native.options import ALPHA_MIN
from .simd_layout import GROUP_SIZE, num_groups

_MOMENTS = 4  # looked at from a frame to the next
_SEEN = 0.9 * ALPHA_MIN  # leaves some for moments in between


def visible_intervals(opacities_at: Callable[[float], np.ndarray], frame_count: int) -> np.ndarray:
    """(frames - 1, M) bool: whether a Gaussian can be seen at some moment from a frame to the next, both included.

    Args:
        opacities_at: (M,) activated, at a time in [0, 1].
        frame_count: at least two.
    """

    def seen_at(frame: float) -> np.ndarray:
        return opacities_at(frame_to_time(frame, frame_count)) >= _SEEN

    at_frame, lives = seen_at(0), []
    for frame in range(1, frame_count):
        seen = at_frame
        for k in range(1, _MOMENTS):
            seen = seen | seen_at(frame - 1 + k / _MOMENTS)
        at_frame = seen_at(frame)
        lives.append(seen | at_frame)
    return np.stack(lives)


def sort_by_visibility(lives: np.ndarray) -> np.ndarray:
    """(M,) an order of Gaussians in which those that live at the same times follow each other; (frames - 1, M)."""
    return np.lexsort(lives[::-1])


def pack_group_bits(lives: np.ndarray) -> np.ndarray:
    """(frames - 1, groups / 8 rounded up) uint8: a bit for each group of Gaussians, set where one of them lives."""
    padded = np.pad(lives, ((0, 0), (0, -lives.shape[1] % GROUP_SIZE)))
    return np.packbits(padded.reshape(len(lives), -1, GROUP_SIZE).any(2), axis=1)


def mean_deformed_share(bits: np.ndarray, count: int) -> float:
    """Of ``count`` Gaussians in the groups of ``pack_group_bits``, how many are deformed at a moment, in the mean."""
    return float(np.unpackbits(bits, axis=1, count=num_groups(count)).mean())


class VisibilityMask:
    """What ``pack_group_bits`` gave, for playback.

    Args:
        bits: from a file.
        count: of Gaussians that move.

    Raises:
        ValueError: for bits of another number of Gaussians.
    """

    def __init__(self, bits: np.ndarray, count: int) -> None:
        groups = num_groups(count)
        if bits.dtype != np.uint8 or bits.ndim != 2 or not len(bits) or bits.shape[1] != -(-groups // 8):
            raise ValueError(f"lifetimes of {groups} groups are {bits.dtype} of shape {bits.shape}")
        self._bits, self._groups = bits, groups

    def select(self, kept: np.ndarray) -> np.ndarray:
        """``pack_group_bits`` for some of the Gaussians alone; (n,) their indices, ascending."""
        lives = np.unpackbits(self._bits, axis=1, count=self._groups).astype(bool)
        return pack_group_bits(lives[:, kept // GROUP_SIZE])

    def at(self, time: float) -> np.ndarray:
        """(groups,) uint8, zero for those that nobody can see at a time in [0, 1]."""
        interval = min(int(time_to_frame(time, len(self._bits) + 1)), len(self._bits) - 1)
        return np.unpackbits(self._bits[interval], count=self._groups)
