"""Gaussians chosen by what they are: opacity, size, place, who sees them, what they hang on, whether they move."""

from collections.abc import Callable

import numpy as np

from ..arrays import Array
from ..errors import FrogError
from ..native.options import ALPHA_MIN
from ..playback.player import ScenePlayer
from .box_tree import BoxTree
from .clusters import clusters

SEEN = 0.05
"""Blending weight from which an image shows a Gaussian; training removes what stays below it everywhere."""
_MOST = 0.01, 0.99  # quantiles of their places; single ones lie kilometres away
_MOST_FRAMES = 64  # that are looked at
_AT_ONCE = 1 << 16  # Gaussians, between which a search can be stopped


def seen_by(weights: Array) -> Array:
    """(N,) how many cameras see each Gaussian, of weights (C, N)."""
    return np.asarray(np.count_nonzero(weights > SEEN, axis=0))


def seen_box(scene: ScenePlayer, weights: Array) -> Array:
    """(2, 3) the corners of a box around all Gaussians that any camera sees, wherever they are drawn; around all that
    are drawn, without cameras.

    Args:
        weights: (C, N) see ``importance.camera_weights``.
    """
    seen = weights.any(axis=0) if weights.any() else np.ones(scene.count, bool)
    last = scene.header.frame_count - 1 if scene.num_dynamic else 0
    corners = []
    for frame in np.linspace(0, last, min(last + 1, _MOST_FRAMES)):
        shown = scene.at_frame(frame)
        points = shown.means[seen & (shown.opacities > ALPHA_MIN)]
        corners += [points.min(axis=0), points.max(axis=0)] if len(points) else []
    if not corners:
        raise FrogError("Found no Gaussian that is drawn, expected some to crop.")
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)], np.float64)


SET, EXTEND, SUBTRACT, INTERSECT = "SET", "EXTEND", "SUBTRACT", "INTERSECT"


def combined(before: Array, these: Array, mode: str) -> Array:
    """(N,) bool: what is selected after these (N,) were selected as well, alone, no longer, or kept alone of those
    selected before."""
    if mode == EXTEND:
        return before | these
    if mode == SUBTRACT:
        return before & ~these
    return before & these if mode == INTERSECT else these


def by_opacity(scene: ScenePlayer, most: float) -> Array:
    """(N,) bool: those whose opacity is at most so large at the beginning, the middle and the end."""
    return np.asarray(np.max([scene.at(time).opacities for time in _times(scene)], axis=0) <= most)


def by_size(scene: ScenePlayer, least: float) -> Array:
    """(N,) bool: those whose largest standard deviation is at least so long, in world units, at one of these times."""
    return np.asarray(np.max([scene.at(time).scales.max(axis=1) for time in _times(scene)], axis=0) >= least)


def by_distance(scene: ScenePlayer, center: Array, least: float, time: float = 0.0) -> Array:
    """(N,) bool: those that lie at least so far, in world units, from a point (3,) at a time."""
    offsets: Array = scene.at(time).means - np.asarray(center, np.float32)
    return np.asarray(np.einsum("ni,ni->n", offsets, offsets) >= least**2)


def by_cameras(weights: Array, fewer_than: int) -> Array:
    """(N,) bool: those that fewer cameras see, of ``importance.camera_weights``."""
    return seen_by(weights) < fewer_than


def cluster_sizes(scene: ScenePlayer, tell: Callable[[float], None] = lambda part: None) -> Array:
    """(N,) how many Gaussians the clusters that they are in have at most, at the beginning, the middle and the end.

    Args:
        tell: told how much is done, 0 to 1; it may raise.
    """
    sizes, times = np.zeros(scene.count, np.int64), _times(scene)
    for index, time in enumerate(times):
        tell(index / len(times))
        cluster = clusters(scene.at(time))
        np.maximum(sizes, np.bincount(cluster)[cluster], out=sizes)
    return sizes


def dynamic(scene: ScenePlayer) -> Array:
    """(N,) bool: those that change in time."""
    return np.arange(scene.count) < scene.num_dynamic


def grown(
    scene: ScenePlayer,
    chosen: Array,
    distance: float,
    time: float = 0.0,
    tell: Callable[[float], None] = lambda part: None,
) -> Array:
    """(N,) bool: the chosen, and all within a distance of one of them, in world units, at a time.

    Args:
        chosen: (N,) bool.
        tell: told how much is done, 0 to 1; it may raise.
    """
    result: Array = chosen.copy()
    if distance > 0 and chosen.any():
        points, others = scene.at(time).means, np.flatnonzero(~chosen)
        tree, parts = BoxTree(points[chosen, None]), np.array_split(others, len(others) // _AT_ONCE + 1)
        for index, some in enumerate(parts):
            tell(index / len(parts))
            result[some] = tree.within(points[some], np.nextafter(distance, np.inf), enough=distance) <= distance
    return result


def spacing(scene: ScenePlayer, time: float = 0.0) -> float:
    """How far apart the Gaussians of a scene are at a time, in world units: the side of the cube that each of them has
    in the box around nearly all of them."""
    low, high = np.quantile(scene.at(time).means.astype(np.float64), _MOST, axis=0)
    return float(np.cbrt((high - low).prod() / scene.count))


def _times(scene: ScenePlayer) -> tuple[float, ...]:
    return (0.0, 0.5, 1.0) if scene.num_dynamic else (0.0,)
