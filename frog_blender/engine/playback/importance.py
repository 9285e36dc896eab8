"""What images lose without a Gaussian: a ranking, and how much of any training image it makes.

The ranking is one order a scene, so that leaving out the last never flickers. There a Gaussian counts by its opacity
times its area (its two largest standard deviations), times the largest share it has in a pixel of the scene's own
cameras; the mean over times spread over the scene.
"""

from collections.abc import Callable

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..gaussians import NumpyGaussians
from ..native.binding import Frame
from ..native.options import RasterizeOptions
from ..scene.header import SceneHeader
from .player import ScenePlayer

_MAX_VIEWS = 8  # images at most: a second for 200,000 Gaussians
_LONGEST_SIDE = 320  # pixels; finer ones rank no better
_UNSEEN = 0.02  # share of what no camera saw: it may be all there is from elsewhere
_MOST_SMALL_VIEWS = 192


def ranking(scene: ScenePlayer) -> Array:
    """(N,) every Gaussian's index, the most important first; the same for the same scene on any day."""
    score = np.zeros(scene.count)
    for camera, frame in sampled_views(scene.header, _MAX_VIEWS):
        gaussians = scene.at_frame(frame)
        largest = np.sort(gaussians.scales, axis=1)[:, 1:].astype(np.float64)
        seen = _visible_weights(gaussians, camera) if camera is not None else 1.0
        score += gaussians.opacities * largest.prod(axis=1) * np.maximum(seen, _UNSEEN)
    return np.argsort(-np.nan_to_num(score), kind="stable")


def camera_weights(scene: ScenePlayer, tell: Callable[[float], None] = lambda part: None) -> Array:
    """(C, N) each Gaussian's largest blending weight in small images of each camera, spread over the times it saw.

    A moving camera counts as the poses that are looked from. Held-out images are left out.

    Args:
        tell: told how much is done, 0 to 1; it may raise.

    Returns:
        float32 in [0, 1]; C is 0 for a scene that does not say what it was filmed with.
    """
    largest: dict[str, Array] = {}
    views = sampled_views(scene.header, _MOST_SMALL_VIEWS, trained=True)
    for index, (camera, frame) in enumerate(views):
        tell(index / len(views))
        if camera is not None:
            weights = _visible_weights(scene.at_frame(frame), camera)
            largest[camera.name] = np.maximum(largest.get(camera.name, 0), weights)
    return np.array(list(largest.values()), np.float32).reshape(len(largest), scene.count)


def most_important(order: Array, count: int) -> Array:
    """(count,) the first of a ranking as ascending indices; at least one."""
    return np.sort(order[: max(1, count)])


def sampled_views(header: SceneHeader, most: int, *, trained: bool = False) -> list[tuple[Camera | None, int]]:
    """At most so many cameras and frames that they saw (``trained``: for training), spread over both; frames alone for
    a scene without cameras."""
    shots: list[tuple[Camera | None, int]] = [
        (camera, frame)
        for camera, frames in zip(header.cameras, header.camera_shots, strict=True)
        for frame in frames
        if 0 <= frame < header.frame_count and not (trained and header.is_test(camera.name, frame))
    ]
    chosen = np.unique(np.linspace(0, (len(shots) or header.frame_count) - 1, most).round().astype(int)).tolist()
    return [shots[index] for index in chosen] if shots else [(None, frame) for frame in chosen]


def _visible_weights(gaussians: NumpyGaussians, camera: Camera) -> Array:
    """(N,) each Gaussian's largest blending weight in a small image."""
    return largest_weights(gaussians, camera.scaled(min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))))


def largest_weights(gaussians: NumpyGaussians, camera: Camera) -> Array:
    """(N,) each Gaussian's largest blending weight in a camera's image."""
    options = RasterizeOptions(weights=True)
    image = options.new_image(camera, len(gaussians))
    Frame(gaussians, camera, (0.0, 0.0, 0.0), options, image)
    return image["max_weights"]
