"""Seed points for cameras too far apart to match: drawn in the volume that several cameras see.

Points whose images agree in colour are preferred, and a share lies on moving objects (see moving.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Float64s
from ..capture import Capture
from ..video import load_opencv
from .moving import moving_points, passing_points
from .views import Images, View, load_view, sample_view, spread

_SAMPLES, _SPARSE_SAMPLES = 300_000, 60_000
_LONGEST_SIDE = 320
_MOVING_SHARE = 0.4


def fill_volume(
    capture: Capture, store: Images, near: float, far: float, *, count: int, random: np.random.Generator
) -> tuple[Float64s, Float64s]:
    """At most ``count`` world points (N, 3) seen by several training cameras, and their colours (N, 3) in [0, 1]."""
    by_frame = _shots_by_frame(capture)
    moves = capture.has_moving_cameras
    shots = spread(capture.train_indices, 12) if moves else _middle(by_frame)
    views = [load_view(capture, store, shot, _LONGEST_SIDE) for shot in shots]
    samples = _sample_frustums(views, near, far, _SAMPLES, random)
    points, colors = np.zeros((0, 3)), np.zeros((0, 3))
    if len(by_frame) >= 3 and not moves:
        points, colors, _ = moving_points(
            capture, store, by_frame, samples, count=int(count * _MOVING_SHARE), random=random
        )
    agreeing, agreeing_colors = _agreeing_points(views, samples, count - len(points), random)
    return np.concatenate([points, agreeing]), np.concatenate([colors, agreeing_colors])


def points_at_times(
    capture: Capture,
    store: Images,
    near: float,
    far: float,
    *,
    count: int,
    num_frames: int,
    random: np.random.Generator,
) -> tuple[Float64s, Float64s, Float64s]:
    """At most ``count`` world points (N, 3) on what moves before static cameras, their colours (N, 3) in [0, 1], and
    the frames (N,), of ``num_frames``, at which they are there; none of a capture of fewer than three frames."""
    by_frame = _shots_by_frame(capture)
    if len(by_frame) < 3:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    views = [load_view(capture, store, shot, _LONGEST_SIDE) for shot in _middle(by_frame)]
    samples = _sample_frustums(views, near, far, _SPARSE_SAMPLES, random)
    return passing_points(capture, store, by_frame, samples, count=count, random=random, num_frames=num_frames)


def _shots_by_frame(capture: Capture) -> dict[int, list[int]]:
    """Training shots of each frame that has any."""
    by_frame: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_frame.setdefault(capture.shots[index].frame, []).append(index)
    return by_frame


def _middle(by_frame: dict[int, list[int]]) -> list[int]:
    """The shots of the middle frame."""
    frames = sorted(by_frame)
    return by_frame[frames[len(frames) // 2]]


def _sample_frustums(
    views: Sequence[View], near: float, far: float, count: int, random: np.random.Generator
) -> Float64s:
    """World points (N, 3) along random rays of the views, evenly spread over the volume, seen by two or three views."""
    each = -(-count // len(views))
    parts = []
    for view in views:
        pixels = random.random((each, 2)) * (view.camera.width, view.camera.height)
        # Even in volume the far end would take all; even in depth gives the near half its share.
        distances = near + (far - near) * random.random(each)
        parts.append(view.camera.unproject(pixels, distances))
    points = np.concatenate(parts)
    seen = sum(sample_view(view, points, view.image)[1].astype(int) for view in views)
    well_seen = points[seen >= 3]
    return well_seen if len(well_seen) >= 0.05 * len(points) else points[seen >= min(2, len(views))]


def _agreeing_points(
    views: Sequence[View], points: Float64s, count: int, random: np.random.Generator
) -> tuple[Float64s, Float64s]:
    """The points at which the views agree best in colour, thinned so that they spread over the volume."""
    cv2 = load_opencv()
    values, weights, roughness = [], [], []
    for view in views:
        mean = cv2.blur(view.image, (3, 3))
        local = np.sqrt(np.maximum(cv2.blur(view.image**2, (9, 9)) - cv2.blur(view.image, (9, 9)) ** 2, 0))
        value, seen = sample_view(view, points, mean)
        rough, _ = sample_view(view, points, local.mean(axis=2))
        values.append(value)
        weights.append(seen)
        roughness.append(rough)
    weight = np.array(weights, dtype=np.float64)  # (V, N)
    total = np.maximum(weight.sum(axis=0), 1)
    value = np.array(values, dtype=np.float64)  # (V, N, 3)
    color = (value * weight[..., None]).sum(axis=0) / total[:, None]
    variance = ((value - color) ** 2 * weight[..., None]).sum(axis=(0, 2)) / total
    # Agreement on a flat wall says little: differences count relative to what the surroundings vary by.
    rough = (np.array(roughness) * weight).sum(axis=0) / total
    score = np.sqrt(variance) / (0.05 + rough) * (0.9 + 0.2 * random.random(len(points)))
    best = np.argsort(score, kind="stable")[: max(count, 0)]
    return points[best], color[best]
