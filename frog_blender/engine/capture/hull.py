"""The visual hull: where a subject can be, which is nowhere but inside its mask in every camera that looks there.

At one time a point is inside where all cameras that see it have it in their mask, and one sees it at least. A subject
that moves is, over time, in the union of these hulls.
"""

from collections.abc import Sequence

import numpy as np

from ..arrays import Array, Bools, Float64s, ImageArray, Ints
from .camera import Camera
from .capture import Capture, Images
from .video import load_opencv, shrunk

_LONGEST_SIDE = 400  # pixels of a mask
_MARGIN = 0.008  # of the longest side: masks are cut a little too close, poses are not exact
_SUBJECT = 64  # of 255: what is fainter is an edge
ALL_BUT = 0.25
"""Share of single views in which a point of the subject may be outside: it moves, and some masks have holes."""


class VisualHull:
    """The masks of some shots, and what lies inside.

    Args:
        capture: its cameras' images have masks.
        store: with their alpha.
        shots: indices into ``capture.shots``, of training images.

    Attributes:
        by_frame: shots with a mask, of each frame that has any.
        frames: these frames, ascending.
        has_single_views: no two cameras look at the same time: then no time alone says how deep anything lies.
    """

    def __init__(self, capture: Capture, store: Images, shots: Sequence[int]) -> None:
        self._capture = capture
        self._masks = {shot: mask for shot in shots if (mask := _inside(store.alpha(shot))) is not None}
        self.by_frame: dict[int, list[int]] = {}
        for shot in self._masks:
            self.by_frame.setdefault(capture.shots[shot].frame, []).append(shot)
        self.frames = sorted(self.by_frame)
        self.has_single_views = all(len(shots) == 1 for shots in self.by_frame.values())

    def time_of(self, frame: int) -> float:
        """The time in [0, 1] of a frame's images."""
        return self._capture.time_of(self._capture.shots[self.by_frame[frame][0]])

    def contains_at(self, points: Float64s, frame: int) -> tuple[Bools, Ints]:
        """Whether (N,) world points (N, 3) are inside at a frame, and how many (N,) cameras see them then."""
        inside, seen = inside_all(*self.views_at(frame), points)
        return inside & (seen > 0), seen

    def views_at(self, frame: int) -> tuple[list[Camera], list[Bools]]:
        """The cameras that look at a frame, and their masks (h, w), which may be smaller than their images."""
        shots = self.by_frame.get(frame, [])
        cameras = [self._capture.cameras[self._capture.shots[shot].camera] for shot in shots]
        return cameras, [self._masks[shot] for shot in shots]

    def shows_at(self, points: Float64s, frame: int) -> Bools:
        """Whether (N,) world points (N, 3) are inside at a frame, and two cameras see them, where there are two."""
        inside, views = self.contains_at(points, frame)
        return inside & (views >= min(2, len(self.by_frame[frame])))

    def contains(self, points: Float64s) -> Bools:
        """Whether (N,) world points (N, 3), which stay where they are, may be the subject's: they are inside at some
        time where two cameras see them, or of single views in all but a few."""
        inside, seen = np.zeros(len(points)), np.zeros(len(points))
        for frame in self.frames:
            inside += self.shows_at(points, frame)
            seen += self.contains_at(points, frame)[1] > 0
        if self.has_single_views:
            return (seen > 0) & (inside >= (1 - ALL_BUT) * seen)
        return inside > 0


def inside_all(cameras: Sequence[Camera], masks: Sequence[Array], points: Float64s) -> tuple[Bools, Ints]:
    """Whether (N,) world points (N, 3) are in the masks (h, w) of all cameras that see them, and how many (N,) do."""
    inside, seen = np.ones(len(points), bool), np.zeros(len(points), np.int64)
    for camera, mask in zip(cameras, masks, strict=True):
        in_mask, in_view = camera.resized(mask.shape[1], mask.shape[0]).sample(points, mask)
        inside &= (in_mask > 0) | ~in_view
        seen += in_view
    return inside, seen


def _inside(alpha: ImageArray | None) -> Bools | None:
    """(h, w) where a reduced mask has the subject, or nearly."""
    if alpha is None:
        return None
    cv2 = load_opencv()
    small = shrunk(np.where(alpha >= _SUBJECT, np.uint8(255), np.uint8(0)), _LONGEST_SIDE)
    reach = max(1, round(_MARGIN * max(small.shape)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(np.where(small > 0, np.uint8(1), np.uint8(0)), kernel) > 0)
