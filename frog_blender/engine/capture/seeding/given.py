"""Seed points that came with the capture, as HyperNeRF's ``points.npy``: positions without colours."""

from __future__ import annotations

import numpy as np

from ...arrays import Float32s, Float64s
from ..capture import Capture
from .views import Images, load_view, sample_view, spread

_VIEWS = 16
_LONGEST_SIDE = 400  # pixels
_MAX_POINTS = 100_000


def given_points(capture: Capture, store: Images, train: list[int]) -> tuple[Float64s, Float32s]:
    """World points (N, 3) that training images see, and their colours (N, 3) float32 in [0, 1].

    N is 0 for captures without points. A point's colour is the median over the views that it projects into, which is
    robust against occlusion in some of them.
    """
    points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    if capture.points is None or not len(capture.points):
        return points, colors
    points = capture.points[:: -(-len(capture.points) // _MAX_POINTS)]
    values, seen = [], []
    for index in spread(train, _VIEWS):
        view = load_view(capture, store, index, _LONGEST_SIDE)
        value, is_seen = sample_view(view, points, view.image)
        values.append(np.where(is_seen[:, None], value, np.nan))
        seen.append(is_seen)
    kept = np.any(seen, axis=0)
    if kept.any():
        colors = np.nanmedian(np.array(values)[:, kept], axis=0).astype(np.float32)
    return points[kept], colors
