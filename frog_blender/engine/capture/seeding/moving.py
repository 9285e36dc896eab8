"""Seed points on moving objects at several frames: limbs that swing far cannot be tracked from one frame's points.

A point is a candidate if it projects into the moving region of every camera that sees it at that frame (the visual
hull). The half of them on which the cameras agree best in colour is taken, as those lie on the surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Bools, Float32s, Float64s
from ..capture import Capture
from ..video import load_opencv
from .views import Images, View, load_view, sample_view, spread

_LONGEST_SIDE = 320
NUM_BACKGROUND_FRAMES = 9
NUM_FRAMES = 12
_CANDIDATES = 480_000  # points at all frames, near those that the coarse search found
_OVERSAMPLED = 4  # times as many points as are wanted are compared between frames
_CHANGE = 0.1  # of the display range: a larger difference from the median image is motion


def moving_points(
    capture: Capture,
    store: Images,
    by_frame: dict[int, list[int]],
    samples: Float64s,
    *,
    count: int,
    random: np.random.Generator,
    num_frames: int = NUM_FRAMES,
) -> tuple[Float64s, Float64s, Float64s]:
    """At most ``count`` world points (N, 3), their colours (N, 3) in [0, 1], and the frames (N,) at which they are
    there.

    Args:
        by_frame: training shots of each frame; the cameras are static.
        samples: (S, 3) world points throughout the seen volume.
        num_frames: that are looked at, at most, evenly spread.
    """
    medians = median_images(capture, store, by_frame)
    frames = spread(sorted(by_frame), num_frames)
    points, colors, times = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)]
    for frame in frames:
        silhouettes = _silhouettes(capture, store, by_frame[frame], medians)
        near, color = _surface(silhouettes, samples, _CANDIDATES // len(frames), random)
        chosen = random.permutation(len(near))[: count // len(frames)]
        points.append(near[chosen])
        colors.append(color[chosen])
        times.append(np.full(len(chosen), float(frame)))
    return np.concatenate(points), np.concatenate(colors), np.concatenate(times)


def passing_points(
    capture: Capture,
    store: Images,
    by_frame: dict[int, list[int]],
    samples: Float64s,
    *,
    count: int,
    random: np.random.Generator,
    num_frames: int,
) -> tuple[Float64s, Float64s, Float64s]:
    """``moving_points``, most of them where something is at few of the frames: a point is drawn with the inverse
    square of the number of frames at which its place lies in the moving region. What stays, or comes back, is found
    by matching; what flies past is not."""
    wanted = _OVERSAMPLED * count
    points, colors, times = moving_points(
        capture, store, by_frame, samples, count=wanted, random=random, num_frames=num_frames
    )
    if not len(points):
        return points, colors, times
    medians, taken = median_images(capture, store, by_frame), np.zeros(len(points))
    for frame in np.unique(times):
        taken += _in_hull(*_silhouettes(capture, store, by_frame[int(frame)], medians), points)[0]
    weights = np.maximum(taken, 1) ** -2.0
    chosen = random.choice(len(points), min(count, len(points)), replace=False, p=weights / weights.sum())
    return points[chosen], colors[chosen], times[chosen]


def _silhouettes(
    capture: Capture, store: Images, shots: Sequence[int], medians: dict[int, Float32s]
) -> tuple[list[View], list[NDArray[np.uint8]]]:
    """The views of a frame, and for each the mask (H, W) of what differs from its camera's median image."""
    # A camera without images at the background's frames has no median to compare with.
    known = [shot for shot in shots if capture.shots[shot].camera in medians]
    views = [load_view(capture, store, shot, _LONGEST_SIDE) for shot in known]
    return views, [_moving_mask(view, medians[capture.shots[view.shot].camera]) for view in views]


def _surface(
    silhouettes: tuple[list[View], list[NDArray[np.uint8]]], samples: Float64s, count: int, random: np.random.Generator
) -> tuple[Float64s, Float64s]:
    """Points (N, 3) on what moves, of ``count`` around the ``samples`` (S, 3) that lie in it, and their colours."""
    inside, _, _ = _in_hull(*silhouettes, samples)
    if not inside.any():
        return np.zeros((0, 3)), np.zeros((0, 3))
    near = _around(samples[inside], count, random)
    inside, color, disagreement = _in_hull(*silhouettes, near)
    chosen = np.flatnonzero(inside)
    best = chosen[np.argsort(disagreement[chosen], kind="stable")[: (len(chosen) + 1) // 2]]
    return near[best], color[best]


def _around(points: Float64s, count: int, random: np.random.Generator) -> Float64s:
    """(count, 3) points scattered about ``points`` (M, 3) as far as those lie apart."""
    some = points[random.permutation(len(points))[:400]]
    distances = np.linalg.norm(some[:, None] - points[None], axis=2)
    apart = np.median(np.partition(distances, min(4, len(points) - 1), axis=1)[:, min(4, len(points) - 1)])
    chosen = random.integers(len(points), size=count)
    scattered: Float64s = points[chosen] + random.normal(size=(count, 3)) * apart
    return scattered


def median_images(capture: Capture, store: Images, by_frame: dict[int, list[int]]) -> dict[int, Float32s]:
    """For each camera the median (H, W, 3) of its images over some frames: the static background."""
    stacks: dict[int, list[Float32s]] = {}
    for frame in spread(sorted(by_frame), NUM_BACKGROUND_FRAMES):
        for shot in by_frame[frame]:
            image = load_view(capture, store, shot, _LONGEST_SIDE).image
            stacks.setdefault(capture.shots[shot].camera, []).append(image)
    return {camera: np.median(np.stack(stack), axis=0) for camera, stack in stacks.items()}


def _moving_mask(view: View, median: Float32s) -> NDArray[np.uint8]:
    """(H, W), 1 where the image differs from the median."""
    cv2 = load_opencv()
    difference = np.abs(view.image - median).max(axis=2)
    mask = cv2.medianBlur((difference > _CHANGE).astype(np.uint8), 5)
    dilated: NDArray[np.uint8] = cv2.dilate(mask, np.ones((5, 5), np.uint8))
    return dilated


def _in_hull(
    views: Sequence[View], masks: Sequence[NDArray[np.uint8]], points: Float64s
) -> tuple[Bools, Float64s, Float64s]:
    """For each point (N, 3) whether (N,) it is in the moving region of all views that see it, and of at least two.

    Also the mean colour (N, 3) over those views, and the standard deviation (N,) of their colours.
    """
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


def background_points(
    capture: Capture, store: Images, distance: float, *, count: int, random: np.random.Generator
) -> tuple[Float64s, Float64s]:
    """Points for what each of a few cameras far apart sees alone: its background.

    Nothing says how deep it is, and from its own camera any depth behind what moves shows the same. Without such points
    the Gaussians of the common volume are stretched over the background, and are missing where something moves.

    Returns:
        At most ``count`` world points (N, 3) at ``distance`` from static training cameras, as many before each, and
    their colours (N, 3) in [0, 1] in the median of its images.
    """
    by_frame: dict[int, list[int]] = {}
    for index in capture.train_indices:
        by_frame.setdefault(capture.shots[index].frame, []).append(index)
    medians = median_images(capture, store, by_frame)
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for index, median in sorted(medians.items()):
        height, width = median.shape[:2]
        spots = random.random((count // len(medians), 2))
        camera = capture.cameras[index]
        points.append(camera.unproject(spots * (camera.width, camera.height), np.full(len(spots), distance)))
        columns, lines = (spots * (width, height)).astype(int).T
        colors.append(median[lines, columns].astype(np.float64))
    return np.concatenate(points), np.concatenate(colors)
