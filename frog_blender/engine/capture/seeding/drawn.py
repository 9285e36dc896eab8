"""Seed points that are drawn, where too few can be measured: in the volume that several cameras see, on what moves
before static cameras, inside a subject's masks, and before the background of cameras that stand far apart.

Of points inside a silhouette in every view, the half is taken on which the views agree best in colour: they lie on the
surface.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Bools, Float64s
from ..hull import VisualHull, inside_all
from ..video import load_opencv
from .views import Cloud, TrainingImages, View, cloud_of, joined, mean_colors, spread

NUM_FRAMES = 12
"""At which points on what moves are drawn, where they have no time of their own."""
_SAMPLES, _SPARSE_SAMPLES = 300_000, 60_000
_MOVING_SHARE = 0.4
_CANDIDATES = 480_000  # points at all frames, near those that the coarse search found
_RAYS = 200_000  # points on rays through a subject, at all frames
_OVERSAMPLED = 4  # times as many points as are wanted are compared between frames
_CHANGE = 0.1  # of the display range: a larger difference from the median image is motion
_SUBJECT = 127  # of 255
NearFar = tuple[float, float]
"""Distances in world units between which the scene lies."""


def fill_volume(images: TrainingImages, near_far: NearFar, count: int, random: np.random.Generator) -> Cloud:
    """At most ``count`` points seen by several training cameras, some of them on what moves."""
    moves = images.capture.has_moving_cameras
    views = images.views(spread(images.train, NUM_FRAMES) if moves else images.middle)
    samples = _sample_frustums(views, near_far, _SAMPLES, random)
    moving = joined([])
    if len(images.by_frame) >= 3 and not moves:
        moving = _moving_points(images, samples, int(count * _MOVING_SHARE), NUM_FRAMES, random)
    at_all_times = cloud_of(moving.points, moving.colors)
    return joined([at_all_times, _agreeing_points(views, samples, count - len(moving), random)])


def points_at_times(
    images: TrainingImages, near_far: NearFar, count: int, num_frames: int, random: np.random.Generator
) -> Cloud:
    """At most ``count`` points on what moves before static cameras, at ``num_frames``; none of fewer than three frames.

    Most of them are where something is at few of the frames: a point is drawn with the inverse square of the number of
    frames at which its place lies in the moving region. What stays, or comes back, is found by matching; what flies
    past is not.
    """
    if len(images.by_frame) < 3:
        return joined([])
    samples = _sample_frustums(images.views(images.middle), near_far, _SPARSE_SAMPLES, random)
    moving = _moving_points(images, samples, _OVERSAMPLED * count, num_frames, random)
    if not len(moving):
        return moving
    taken = np.zeros(len(moving))
    for frame in np.unique(moving.frames):
        taken += _in_hull(*_silhouettes(images, int(frame)), moving.points)
    weights = np.maximum(taken, 1) ** -2.0
    return moving[random.choice(len(moving), min(count, len(moving)), replace=False, p=weights / weights.sum())]


def background_points(images: TrainingImages, distance: float, count: int, random: np.random.Generator) -> Cloud:
    """At most ``count`` points for what each of a few cameras far apart sees alone: its background.

    Nothing says how deep it is, and from its own camera any depth behind what moves shows the same. Without such points
    the Gaussians of the common volume are stretched over the background, and are missing where something moves. As many
    lie at ``distance`` before each static training camera, in the colours of the median of its images.
    """
    clouds = []
    for index, median in sorted(images.medians.items()):
        height, width = median.shape[:2]
        spots = random.random((count // len(images.medians), 2))
        camera = images.capture.cameras[index]
        points = camera.unproject(spots * (camera.width, camera.height), np.full(len(spots), distance))
        columns, lines = (spots * (width, height)).astype(int).T
        clouds.append(cloud_of(points, median[lines, columns]))
    return joined(clouds)


def subject_points(
    images: TrainingImages, hull: VisualHull, near_far: NearFar, count: int, random: np.random.Generator
) -> Cloud:
    """At most ``count`` points inside the hull of a subject that has masks, at several frames where it moves."""
    groups = [hull.by_frame[frame] for frame in spread(hull.frames, NUM_FRAMES)]
    if hull.has_single_views:
        groups = [[shot for group in groups for shot in group]]
    clouds = []
    for shots in groups:
        views = images.views(shots)
        rays = [_along_rays(images, view, near_far, _RAYS // len(groups) // len(views), random) for view in views]
        drawn = np.concatenate(rays)
        frame = images.capture.shots[shots[0]].frame
        is_inside = hull.contains(drawn) if hull.has_single_views else hull.shows_at(drawn, frame)
        clouds.append(_on_surface(views, drawn[is_inside], max(count, 0) // len(groups), random))
    return joined(clouds)


def _sample_frustums(views: Sequence[View], near_far: NearFar, count: int, random: np.random.Generator) -> Float64s:
    """World points (N, 3) along random rays of the views, evenly spread over the volume, seen by two or three views."""
    (near, far), of_view = near_far, -(-count // len(views))
    parts = []
    for view in views:
        pixels = random.random((of_view, 2)) * (view.camera.width, view.camera.height)
        # Even in volume the far end would take all; even in depth gives the near half its share.
        parts.append(view.camera.unproject(pixels, near + (far - near) * random.random(of_view)))
    points = np.concatenate(parts)
    seen = sum(view.camera.sample(points, view.image)[1].astype(int) for view in views)
    well_seen = points[seen >= 3]
    return well_seen if len(well_seen) >= 0.05 * len(points) else points[seen >= min(2, len(views))]


def _agreeing_points(views: Sequence[View], points: Float64s, count: int, random: np.random.Generator) -> Cloud:
    """The points at which the views agree best in colour, thinned so that they spread over the volume."""
    cv2 = load_opencv()
    variances = [cv2.blur(view.image**2, (9, 9)) - cv2.blur(view.image, (9, 9)) ** 2 for view in views]
    color, variance = mean_colors(views, points, [cv2.blur(view.image, (3, 3)) for view in views])
    # Agreement on a flat wall says little: differences count relative to what the surroundings vary by.
    rough, _ = mean_colors(views, points, [np.sqrt(np.maximum(local, 0)).mean(axis=2) for local in variances])
    score = np.sqrt(variance) / (0.05 + rough[:, 0]) * (0.9 + 0.2 * random.random(len(points)))
    best = np.argsort(score, kind="stable")[: max(count, 0)]
    return cloud_of(points[best], color[best])


def _moving_points(
    images: TrainingImages, samples: Float64s, count: int, num_frames: int, random: np.random.Generator
) -> Cloud:
    """At most ``count`` points on what moves before static cameras: inside the moving region of all that see them.

    Args:
        samples: (S, 3) world points throughout the seen volume.
        num_frames: that are looked at, at most, evenly spread: limbs that swing far cannot be tracked from one frame's
            points.
    """
    frames, clouds = spread(sorted(images.by_frame), num_frames), []
    for frame in frames:
        views, masks = _silhouettes(images, frame)
        inside = samples[_in_hull(views, masks, samples)]
        if len(inside):
            near = _around(inside, _CANDIDATES // len(frames), random)
            near = near[_in_hull(views, masks, near)]
            clouds.append(_on_surface(views, near, count // len(frames), random, frame))
    return joined(clouds)


def _silhouettes(images: TrainingImages, frame: int) -> tuple[list[View], list[NDArray[np.uint8]]]:
    """The views of a frame, and for each the mask (H, W), 1 where it differs from its camera's median image."""
    cv2 = load_opencv()
    cameras, masks = images.capture.shots, []
    # A camera without images at the background's frames has no median to compare with.
    views = images.views([shot for shot in images.by_frame[frame] if cameras[shot].camera in images.medians])
    for view in views:
        difference = np.abs(view.image - images.medians[cameras[view.shot].camera]).max(axis=2)
        mask = cv2.medianBlur((difference > _CHANGE).astype(np.uint8), 5)
        masks.append(cv2.dilate(mask, np.ones((5, 5), np.uint8)))
    return views, masks


def _in_hull(views: Sequence[View], masks: Sequence[NDArray[np.uint8]], points: Float64s) -> Bools:
    """For each point (N, 3) whether (N,) it is in the masks of all views that see it, and of at least two."""
    inside, seen = inside_all([view.camera for view in views], masks, points)
    return inside & (seen >= 2)


def _around(points: Float64s, count: int, random: np.random.Generator) -> Float64s:
    """(count, 3) points scattered about ``points`` (M, 3) as far as those lie apart."""
    some = points[random.permutation(len(points))[:400]]
    distances = np.linalg.norm(some[:, None] - points[None], axis=2)
    nth = min(4, len(points) - 1)
    apart = np.median(np.partition(distances, nth, axis=1)[:, nth])
    chosen = random.integers(len(points), size=count)
    return np.asarray(points[chosen] + random.normal(size=(count, 3)) * apart)


def _on_surface(
    views: Sequence[View], points: Float64s, count: int, random: np.random.Generator, frame: float = np.nan
) -> Cloud:
    """At most ``count`` of the half of the points (N, 3) on which the views agree best in colour; see ``cloud_of``."""
    color, variance = mean_colors(views, points)
    best = np.argsort(variance, kind="stable")[: (len(points) + 1) // 2]
    chosen = random.permutation(best)[:count]
    return cloud_of(points[chosen], color[chosen], frame)


def _along_rays(
    images: TrainingImages, view: View, near_far: NearFar, count: int, random: np.random.Generator
) -> Float64s:
    """(count, 3) world points on rays through the subject's pixels, none where the view has none."""
    alpha = images.store.alpha(view.shot)
    assert alpha is not None  # of a shot of the hull's
    lines, columns = np.nonzero(alpha > _SUBJECT)
    if not len(lines):
        return np.zeros((0, 3))
    chosen = random.integers(0, len(lines), count)
    pixels = np.stack([columns[chosen], lines[chosen]], axis=1) + random.random((count, 2))
    pixels *= (view.camera.width / alpha.shape[1], view.camera.height / alpha.shape[0])
    near, far = near_far
    return view.camera.unproject(pixels, near + (far - near) * random.random(count))
