"""Seed points of a subject that has masks: drawn inside its visual hull, at several frames where it moves."""

from __future__ import annotations

import numpy as np

from ...arrays import Bools, Float64s
from ..capture import Capture
from ..hull import VisualHull
from .views import Images, View, load_view, sample_view, spread

_LONGEST_SIDE = 320
_NUM_FRAMES = 12
_CANDIDATES = 200_000  # rays' points, over all frames
_SUBJECT = 127  # of 255


def subject_points(
    capture: Capture,
    store: Images,
    hull: VisualHull,
    near_far: tuple[float, float],
    count: int,
    random: np.random.Generator,
) -> tuple[Float64s, Float64s]:
    """At most ``count`` world points (N, 3) inside the hull, and their colours (N, 3) in [0, 1].

    Of those of a frame the half is taken on which the cameras agree best: they lie on the surface.
    """
    groups = [hull.shots_at(frame) for frame in spread(hull.frames, _NUM_FRAMES)]
    if hull.has_single_views:
        groups = [[shot for group in groups for shot in group]]
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for shots in groups:
        views = [load_view(capture, store, shot, _LONGEST_SIDE) for shot in shots]
        rays = [_along_rays(view, store, near_far, _CANDIDATES // len(groups) // len(views), random) for view in views]
        found = np.concatenate(rays)
        frame = capture.shots[shots[0]].frame
        found = found[hull.contains(found) if hull.has_single_views else hull.contains_at(found, frame)[0]]
        color, disagreement = _colors(views, found)
        best = np.argsort(disagreement, kind="stable")[: (len(found) + 1) // 2]
        chosen = random.permutation(best)[: max(count, 0) // len(groups)]
        points.append(found[chosen])
        colors.append(color[chosen])
    return np.concatenate(points), np.concatenate(colors)


def _along_rays(
    view: View, store: Images, near_far: tuple[float, float], count: int, random: np.random.Generator
) -> Float64s:
    """(count, 3) world points on rays through the subject's pixels, none where the view has none."""
    alpha = store.alpha(view.shot)
    lines, columns = np.nonzero(alpha > _SUBJECT) if alpha is not None else (np.zeros(0, int), np.zeros(0, int))
    if alpha is None or not len(lines):
        return np.zeros((0, 3))
    chosen = random.integers(0, len(lines), count)
    pixels = np.stack([columns[chosen], lines[chosen]], axis=1) + random.random((count, 2))
    pixels *= (view.camera.width / alpha.shape[1], view.camera.height / alpha.shape[0])
    near, far = near_far
    return view.camera.unproject(pixels, near + (far - near) * random.random(count))


def _colors(views: list[View], points: Float64s) -> tuple[Float64s, Float64s]:
    """Mean colours (N, 3) of points in the views that see them, and the variance (N,) over those."""
    values, weights = [], list[Bools]()
    for view in views:
        value, seen = sample_view(view, points, view.image)
        values.append(value)
        weights.append(seen)
    weight, value = np.array(weights, dtype=np.float64), np.array(values, dtype=np.float64)
    total = np.maximum(weight.sum(axis=0), 1)
    color = (value * weight[..., None]).sum(axis=0) / total[:, None]
    return color, ((value - color) ** 2 * weight[..., None]).sum(axis=(0, 2)) / total
