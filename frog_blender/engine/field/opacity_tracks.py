"""Gaussians of which nothing changes but their opacity, which a track says for every frame. No torch.

What moves fast is made of many Gaussians that come and go, and hardly stir while they are there
(docs/experiments/compression.md).
They need no embedding and no network: playback reads their opacities.
"""

from __future__ import annotations

import numpy as np

from ..capture.time import time_to_frame

LEVELS = 255
"""Opacities are told apart by so much; the first step is about where the rasterizer begins to draw."""


def quantize_opacities(opacities: np.ndarray) -> np.ndarray:
    """uint8 from activated opacities, in the same shape."""
    return np.rint(LEVELS * opacities.clip(0, 1)).astype(np.uint8)


class OpacityTracks:
    """Opacities of those that only fade, for playback: linear from one frame to the next.

    Args:
        tracks: (F, frames) uint8, from a file.

    Raises:
        ValueError: for anything else, and for none.
    """

    def __init__(self, tracks: np.ndarray) -> None:
        if tracks.dtype != np.uint8 or tracks.ndim != 2 or not tracks.size:
            raise ValueError(f"fades are {tracks.dtype} of shape {tracks.shape}")
        self._by_frame = np.ascontiguousarray(tracks.T).astype(np.float32) / LEVELS

    def __len__(self) -> int:
        return self._by_frame.shape[1]

    def at(self, time: float, result: np.ndarray) -> None:
        """Fills ``result`` (F,) float32 at a time in [0, 1]."""
        frames = len(self._by_frame)
        frame = time_to_frame(time, frames)
        first = min(int(frame), frames - 1)
        before, after = self._by_frame[first], self._by_frame[min(first + 1, frames - 1)]
        np.subtract(after, before, out=result)
        result *= np.float32(frame - first)
        result += before
