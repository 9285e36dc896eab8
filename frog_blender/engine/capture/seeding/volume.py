"""Seed points for cameras too far apart to match: drawn in the volume that several cameras see.

Points whose pictures agree in colour are preferred, and a share lies in the hull of what moves: points that fall into
the moving region of every camera that sees them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..capture import Capture
from ..video import load_opencv
from .views import Pictures, View, load_view, spread, train_indices

_SAMPLES = 300_000
_LONGEST_SIDE = 320
_MOVING_SHARE = 0.4
_BACKGROUND_MOMENTS = 9


def fill_volume(
    capture: Capture, store: Pictures, near: float, far: float, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """At most ``count`` world points (N, 3) seen by several training cameras, and their colours (N, 3) in [0, 1]."""
    by_frame: dict[int, list[int]] = {}
    for index in train_indices(capture):
        by_frame.setdefault(capture.shots[index].frame, []).append(index)
    frames = sorted(by_frame)
    if capture.is_moving:
        shots = spread(train_indices(capture), 12)
        moving: dict[int, list[int]] = {}
    else:
        shots = by_frame[frames[len(frames) // 2]]
        moving = {frame: by_frame[frame] for frame in spread(frames, 3)}
    views = [load_view(capture, store, shot, _LONGEST_SIDE) for shot in shots]
    samples = _sample_frustums(views, near, far, _SAMPLES, random)
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3))]
    medians = _median_pictures(capture, store, by_frame) if len(frames) >= 3 and moving else {}
    hulls = [
        _moving_points(capture, [load_view(capture, store, s, _LONGEST_SIDE) for s in moment], medians, samples)
        for moment in moving.values()
        if medians
    ]
    for found, found_colors in hulls:
        share = int(count * _MOVING_SHARE / len(hulls))
        chosen = random.permutation(len(found))[:share]
        points.append(found[chosen])
        colors.append(found_colors[chosen])
    rest = count - sum(map(len, points))
    agreeing, agreeing_colors = _agreeing_points(views, samples, rest, random)
    points.append(agreeing)
    colors.append(agreeing_colors)
    return np.concatenate(points), np.concatenate(colors)


def look_up(view: View, points: np.ndarray, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (N, ...) of a picture where the points (N, 3) project, and whether (N,) the view sees them at all."""
    pixels, depths = view.camera.project(points)
    # Far outside is as good as outside; the clip keeps the conversion to integers defined.
    columns, lines = np.floor(np.clip(pixels, -1.0, 1e6)).astype(int).T
    height, width = picture.shape[:2]
    seen = (depths > 0) & (columns >= 0) & (lines >= 0) & (columns < width) & (lines < height)
    return picture[np.where(seen, lines, 0), np.where(seen, columns, 0)], seen


def _sample_frustums(
    views: Sequence[View], near: float, far: float, count: int, random: np.random.Generator
) -> np.ndarray:
    """World points (N, 3) along random rays of the views, evenly spread over the volume, seen by two or three views."""
    each = -(-count // len(views))
    parts = []
    for view in views:
        pixels = random.random((each, 2)) * (view.camera.width, view.camera.height)
        # Even in volume the far end would take all; even in depth gives the near half its share.
        distances = near + (far - near) * random.random(each)
        parts.append(view.camera.unproject(pixels, distances))
    points = np.concatenate(parts)
    seen = sum(look_up(view, points, view.picture)[1].astype(int) for view in views)
    well_seen = points[seen >= 3]
    return well_seen if len(well_seen) >= 0.05 * len(points) else points[seen >= min(2, len(views))]


def _agreeing_points(
    views: Sequence[View], points: np.ndarray, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The points at which the views agree best in colour, thinned so that they spread over the volume."""
    cv2 = load_opencv()
    values, weights, roughness = [], [], []
    for view in views:
        mean = cv2.blur(view.picture, (3, 3))
        local = np.sqrt(np.maximum(cv2.blur(view.picture**2, (9, 9)) - cv2.blur(view.picture, (9, 9)) ** 2, 0))
        value, seen = look_up(view, points, mean)
        rough, _ = look_up(view, points, local.mean(axis=2))
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


def _median_pictures(capture: Capture, store: Pictures, by_frame: dict[int, list[int]]) -> dict[int, np.ndarray]:
    """For each camera the median (H, W, 3) of its pictures over some moments: what stands still."""
    frames = spread(sorted(by_frame), _BACKGROUND_MOMENTS)
    stacks: dict[int, list[np.ndarray]] = {}
    for frame in frames:
        for shot in by_frame[frame]:
            picture = load_view(capture, store, shot, _LONGEST_SIDE).picture
            stacks.setdefault(capture.shots[shot].camera, []).append(picture)
    return {camera: np.median(np.stack(stack), axis=0) for camera, stack in stacks.items()}


def _moving_points(
    capture: Capture, views: Sequence[View], medians: dict[int, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The points that lie in the moving region of all views that see them (two at least), and their mean colours."""
    cv2 = load_opencv()
    seen_by = np.zeros(len(points), dtype=int)
    moving_in = np.zeros(len(points), dtype=int)
    color = np.zeros((len(points), 3))
    for view in views:
        difference = np.abs(view.picture - medians[capture.shots[view.shot].camera]).max(axis=2)
        mask = cv2.medianBlur((difference > 0.1).astype(np.uint8), 5)
        mask = cv2.dilate(mask, np.ones((7, 7), np.uint8))
        is_moving, seen = look_up(view, points, mask)
        value, _ = look_up(view, points, view.picture)
        seen_by += seen
        moving_in += seen & (is_moving > 0)
        color += value * seen[:, None]
    inside = (seen_by >= 2) & (moving_in == seen_by)
    return points[inside], color[inside] / seen_by[inside, None]
