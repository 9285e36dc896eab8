"""The visual hull: where a subject can be, which is nowhere but inside its mask in every camera that looks there.

At one time a point is inside where all cameras that see it have it in their mask, and one sees it at least. A subject
that moves is, over time, in the union of these hulls.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..arrays import Bools, Float64s, ImageArray
from .capture import Capture
from .video import load_opencv

_LONGEST_SIDE = 400  # pixels of a mask
_MARGIN = 0.008  # of the longest side: masks are cut a little too close, poses are not exact
_SUBJECT = 64  # of 255: what is fainter is an edge
ALL_BUT = 0.25
"""Share of times, or of one camera's views, at which a point of the subject may be outside: of moving things some are
found late, and some masks have holes."""


class Alphas(Protocol):
    """What a hull needs of a frame store."""

    def alpha(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8 the subject's share of each pixel."""
        ...


class VisualHull:
    """The masks of some shots, and what lies inside.

    Args:
        capture: its cameras' images have masks.
        store: with their alpha.
        shots: indices into ``capture.shots``, of training images.

    Attributes:
        frames: those with a mask, ascending.
        has_single_views: no two cameras look at the same time: then no time alone says how deep anything lies.
    """

    def __init__(self, capture: Capture, store: Alphas, shots: Sequence[int]) -> None:
        self._capture = capture
        self._masks = {shot: mask for shot in shots if (mask := _inside(store.alpha(shot))) is not None}
        self._by_frame: dict[int, list[int]] = {}
        for shot in self._masks:
            self._by_frame.setdefault(capture.shots[shot].frame, []).append(shot)
        self.frames = sorted(self._by_frame)
        self.has_single_views = all(len(shots) == 1 for shots in self._by_frame.values())

    def shots_at(self, frame: int) -> list[int]:
        """Shots of a frame with a mask."""
        return self._by_frame[frame]

    def time_of(self, frame: int) -> float:
        """The time in [0, 1] of a frame's images."""
        return self._capture.time_of(self._capture.shots[self._by_frame[frame][0]])

    def contains_at(self, points: Float64s, frame: int) -> tuple[Bools, Bools]:
        """Whether (N,) world points (N, 3) are inside at a frame, and whether (N,) a camera sees them then."""
        inside, seen = np.ones(len(points), bool), np.zeros(len(points), bool)
        for shot in self._by_frame.get(frame, []):
            in_mask, in_view = self._look(points, shot)
            inside &= in_mask | ~in_view
            seen |= in_view
        return inside & seen, seen

    def contains(self, points: Float64s) -> Bools:
        """Whether (N,) world points (N, 3), which stay where they are, may be the subject's: they are inside at some
        time, or of single views in all but a few."""
        inside, seen = np.zeros(len(points)), np.zeros(len(points))
        for frame in self.frames:
            found = self.contains_at(points, frame)
            inside += found[0]
            seen += found[1]
        if self.has_single_views:
            return (seen > 0) & (inside >= (1 - ALL_BUT) * seen)
        return inside > 0

    def _look(self, points: Float64s, shot: int) -> tuple[Bools, Bools]:
        camera, mask = self._capture.cameras[self._capture.shots[shot].camera], self._masks[shot]
        height, width = mask.shape
        pixels, depths = camera.resized(width, height).project(points)
        columns, lines = np.floor(np.clip(np.nan_to_num(pixels, nan=-1.0), -1.0, 1e6)).astype(int).T
        seen = (depths > 0) & (columns >= 0) & (lines >= 0) & (columns < width) & (lines < height)
        return mask[np.where(seen, lines, 0), np.where(seen, columns, 0)], seen


def _inside(alpha: ImageArray | None) -> Bools | None:
    """(h, w) where a reduced mask has the subject, or nearly."""
    if alpha is None:
        return None
    cv2 = load_opencv()
    height, width = alpha.shape
    scale = min(1.0, _LONGEST_SIDE / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    subject = np.where(alpha >= _SUBJECT, np.uint8(255), np.uint8(0))
    small = subject if scale == 1 else cv2.resize(subject, size, interpolation=cv2.INTER_AREA)
    reach = max(1, round(_MARGIN * max(size)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    inside: Bools = cv2.dilate(np.where(small > 0, np.uint8(1), np.uint8(0)), kernel) > 0
    return inside
