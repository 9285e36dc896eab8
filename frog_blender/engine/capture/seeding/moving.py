"""Seed points on what moves, moment by moment: limbs that swing far cannot be followed from one moment's points.

A point belongs to what moves when it falls into the moving region of every camera that sees it at that moment (the
visual hull); of those, the half on which the cameras agree better in colour is taken, since it lies on the surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..capture import Capture
from ..video import load_opencv
from .views import Images, View, load_view, sample_view, spread

_LONGEST_SIDE = 320
_BACKGROUND_MOMENTS = 9
_MOMENTS = 12
_CANDIDATES = 40_000  # points looked at for each moment, near those that the coarse search found
_CHANGE = 0.1  # of the display range: a larger difference from the median image is motion


def moving_points(
    capture: Capture,
    store: Images,
    by_frame: dict[int, list[int]],
    samples: np.ndarray,
    count: int,
    random: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """At most ``count`` world points (N, 3) and their colours (N, 3) in [0, 1].

    Args:
        by_frame: training shots of each frame; the cameras stand still.
        samples: (S, 3) world points all over the seen volume.
    """
    medians = _median_images(capture, store, by_frame)
    frames = spread(sorted(by_frame), _MOMENTS)
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for frame in frames:
        # A camera whose images are missing at the background's moments cannot say what moves.
        known = [shot for shot in by_frame[frame] if capture.shots[shot].camera in medians]
        views = [load_view(capture, store, shot, _LONGEST_SIDE) for shot in known]
        masks = [_moving_mask(view, medians[capture.shots[view.shot].camera]) for view in views]
        inside, _, _ = _in_hull(views, masks, samples)
        if inside.any():
            near = _around(samples[inside], _CANDIDATES, random)
            inside, color, disagreement = _in_hull(views, masks, near)
            chosen = np.flatnonzero(inside)
            best = chosen[np.argsort(disagreement[chosen], kind="stable")[: (len(chosen) + 1) // 2]]
            chosen = random.permutation(best)[: count // len(frames)]
            points.append(near[chosen])
            colors.append(color[chosen])
    return np.concatenate(points), np.concatenate(colors)


def _around(points: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """(count, 3) points scattered about ``points`` (M, 3) as far as those lie apart."""
    some = points[random.permutation(len(points))[:400]]
    distances = np.linalg.norm(some[:, None] - points[None], axis=2)
    apart = np.median(np.partition(distances, min(4, len(points) - 1), axis=1)[:, min(4, len(points) - 1)])
    chosen = random.integers(len(points), size=count)
    return points[chosen] + random.normal(size=(count, 3)) * apart


def _median_images(capture: Capture, store: Images, by_frame: dict[int, list[int]]) -> dict[int, np.ndarray]:
    """For each camera the median (H, W, 3) of its images over some moments: what stands still."""
    stacks: dict[int, list[np.ndarray]] = {}
    for frame in spread(sorted(by_frame), _BACKGROUND_MOMENTS):
        for shot in by_frame[frame]:
            image = load_view(capture, store, shot, _LONGEST_SIDE).image
            stacks.setdefault(capture.shots[shot].camera, []).append(image)
    return {camera: np.median(np.stack(stack), axis=0) for camera, stack in stacks.items()}


def _moving_mask(view: View, median: np.ndarray) -> np.ndarray:
    cv2 = load_opencv()
    difference = np.abs(view.image - median).max(axis=2)
    mask = cv2.medianBlur((difference > _CHANGE).astype(np.uint8), 5)
    return cv2.dilate(mask, np.ones((5, 5), np.uint8))


def _in_hull(
    views: Sequence[View], masks: Sequence[np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether (N,) all views that see a point, two at least, see motion there; their mean colour (N, 3); and the
    standard deviation (N,) of their colours."""
    seen_by, moving_in = np.zeros(len(points)), np.zeros(len(points))
    color, square = np.zeros((len(points), 3)), np.zeros((len(points), 3))
    for view, mask in zip(views, masks, strict=True):
        is_moving, seen = sample_view(view, points, mask)
        value = sample_view(view, points, view.image)[0] * seen[:, None]
        seen_by += seen
        moving_in += seen & (is_moving > 0)
        color += value
        square += value**2
    inside = (seen_by >= 2) & (moving_in == seen_by)
    color /= np.maximum(seen_by, 1)[:, None]
    variance = np.maximum(square / np.maximum(seen_by, 1)[:, None] - color**2, 0).sum(axis=1)
    return inside, color, np.sqrt(variance)
