"""Seed points for what each of a few cameras far apart sees alone: its background.

Nothing says how deep it is, and from its own camera any depth behind what moves shows the same. Without such points
the Gaussians of the common volume are stretched over the background, and are missing where something moves.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Float64s
from ..capture import Capture
from .moving import median_images
from .views import Images


def background_points(
    capture: Capture, store: Images, distance: float, *, count: int, random: np.random.Generator
) -> tuple[Float64s, Float64s]:
    """At most ``count`` world points (N, 3) at ``distance`` from static training cameras, as many before each, and
    their colours (N, 3) in [0, 1] in the median of its images."""
    by_frame: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_frame.setdefault(capture.shots[index].frame, []).append(index)
    medians = median_images(capture, store, by_frame)
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for index, median in sorted(medians.items()):
        height, width = median.shape[:2]
        places = random.random((count // len(medians), 2))
        camera = capture.cameras[index]
        points.append(camera.unproject(places * (camera.width, camera.height), np.full(len(places), distance)))
        columns, lines = (places * (width, height)).astype(int).T
        colors.append(median[lines, columns].astype(np.float64))
    return np.concatenate(points), np.concatenate(colors)
