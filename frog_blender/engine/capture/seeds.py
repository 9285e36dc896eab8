"""Seed points for the first Gaussians: points on the scene's surfaces, found from the training images alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Float32s, Float64s, Floats, Ints
from ..errors import FrogError
from .capture import Capture
from .hull import VisualHull
from .seeding.completion import ConfirmedDepth, points_seen_once
from .seeding.matching import triangulate
from .seeding.moving import background_points
from .seeding.plane_sweep import DepthMap, consistent, sweep, world_points
from .seeding.subject import subject_points
from .seeding.views import Images, View, load_view, neighbours, sample_view, scene_depth, spread
from .seeding.volume import fill_volume, points_at_times

_MATCH_SIDE, _SWEEP_SIDE = 800, 256  # longest side in pixels
_MATCH_VIEWS = 36
_SWEEP_REFERENCES = 12
_ENOUGH = 5000  # measured points: with fewer, further ones are drawn in the volume
_UNTEXTURED_SHARE = 0.3
_HULL_FRAMES = 24
_FEW_VIEWS = 4  # cameras: of more, other pairs see most of what two do not
_BACKGROUND_SHARE = 0.4  # of the points, where no two cameras match
_BEHIND = 0.8  # of the farthest depth that is searched
_FEWEST_CAMERAS = 8  # whose silhouettes enclose what moves closely enough: seeds in it cost scenes of six or fewer
_GIVEN_VIEWS, _GIVEN_SIDE, _MOST_GIVEN = 16, 400, 100_000  # images, pixels, points that came with the capture
_MOVING_SHARE = 0.25  # of all seed points, those at moments of their own, at most


@dataclass(frozen=True, eq=False)
class Seeds:
    """Points to start from.

    Attributes:
        points: (N, 3) float32, world units.
        colors: (N, 3) float32 in [0, 1].
        origin: how they were found, in words.
        frames: (N,) float32 at which points on what moves are there, NaN of points that are there at all times; None
            where all are.
    """

    points: Float32s
    colors: Float32s
    origin: str
    frames: Float32s | None = None


Cloud = tuple[Float64s, Floats]
"""World points (N, 3) and their colours (N, 3) in [0, 1]."""


def find_seeds(
    capture: Capture,
    store: Images,
    *,
    count_limit: int = 25_000,
    seed: int = 0,
    share: float = 1.0,
    num_moments: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Seeds:
    """Seed points from matched features and a plane sweep, or from the common volume where views are too far apart.

    Points that came with the capture count as matched ones.

    Only training shots are read; the same input and seed give the same points.

    Args:
        count_limit: at most this many points.
        share: of ``count_limit``, the maximum number of measured points, as if matching had found no more.
        num_moments: frames at which what moves before many static cameras gets points of its own, as far as there is
            any.
        progress: called with (steps done, steps in all).

    Raises:
        FrogError: if no training image is left, or no point is seen by the cameras.
    """
    train = capture.train_indices
    if not train:
        raise FrogError(f"{capture.path}: every image is held out, expected some to train on.")
    random = np.random.default_rng(seed)
    references = _references(capture, train)
    steps = len(references) + 2

    def report(done: int) -> None:
        if progress is not None:
            progress(done, steps)

    cameras = [capture.cameras[capture.shots[index].camera] for index in train]
    depth = _typical(capture.near_far) if capture.near_far else scene_depth(cameras)
    found, given = _match(capture, store, train, depth), _given_points(capture, store, train)
    matched = np.concatenate([found[0], given[0]]), np.concatenate([found[1], given[1]])
    report(1)
    near, far = _depth_range(capture, matched[0], depth)
    moving = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    if num_moments and _hull_is_tight(capture, train):
        most, own = int(_MOVING_SHARE * count_limit), np.random.default_rng((seed, 1))
        moving = points_at_times(capture, store, near, far, count=most, num_frames=num_moments, random=own)
        count_limit -= len(moving[0])
    swept, textured = _sweep(capture, store, references, (near, far), lambda done: report(1 + done))
    measured = len(matched[0]) + len(swept[0])
    views_match = measured > 0
    parts = []
    if measured:
        keep = _choose(textured, count_limit - min(len(matched[0]), count_limit // 3), random)
        some = random.permutation(len(matched[0]))[: count_limit // 3]
        points = np.concatenate([matched[0][some], swept[0][keep]])
        colors = np.concatenate([matched[1][some], swept[1][keep]])
        parts.append(merge_points((points, colors), np.array([camera.center for camera in cameras]), count_limit))
    if share < 1 and measured:
        kept = random.permutation(len(parts[0][0]))[: int(share * count_limit)]
        measured = len(kept)
        parts = [(parts[0][0][kept], parts[0][1][kept])]
    hull = _hull(capture, store, train)
    if hull is not None and parts:  # images of a subject over one colour match where there is nothing
        inside = hull.contains(parts[0][0])
        parts, measured = [(parts[0][0][inside], parts[0][1][inside])], int(inside.sum())
    counts = {"matched": len(found[0]), "given": len(given[0]), "swept": len(swept[0])}
    if measured < _ENOUGH:
        wanted = count_limit - sum(len(part[0]) for part in parts)
        if hull is not None:
            parts.append(subject_points(capture, store, hull, (near, far), wanted, random))
        elif views_match or not _has_film_of_several(capture, train):
            parts.append(fill_volume(capture, store, near, far, count=wanted, random=random))
        else:
            most = int(_BACKGROUND_SHARE * wanted)
            parts.append(background_points(capture, store, _BEHIND * far, count=most, random=random))
            counts["behind"] = len(parts[-1][0])
            parts.append(fill_volume(capture, store, near, far, count=wanted - counts["behind"], random=random))
        counts["drawn"] = len(parts[-1][0])
    report(steps)
    points = np.concatenate([*(part[0] for part in parts), moving[0]])
    colors = np.concatenate([*(part[1] for part in parts), moving[1]])
    frames = np.concatenate([np.full(len(points) - len(moving[2]), np.nan), moving[2]]).astype(np.float32)
    counts["moving"] = len(moving[2])
    finite = np.isfinite(points).all(axis=1)
    if hull is not None and not finite.any():
        raise FrogError(f"{capture.path}: no point lies inside the masks of all cameras: are they of these images?")
    if not finite.any():
        raise FrogError(f"{capture.path}: no point is seen by two training cameras: are the poses right?")
    origin = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    return Seeds(
        points[finite].astype(np.float32),
        np.clip(colors[finite], 0, 1).astype(np.float32),
        origin,
        frames[finite] if counts["moving"] else None,
    )


def _hull_is_tight(capture: Capture, train: list[int]) -> bool:
    """Whether silhouettes of what moves before the background can tell where it is."""
    cameras = {capture.shots[index].camera for index in train}
    return len(cameras) >= _FEWEST_CAMERAS and not capture.has_moving_cameras and not capture.has_masks


def _has_film_of_several(capture: Capture, train: list[int]) -> bool:
    """Whether several static cameras have more than an image each."""
    cameras = {capture.shots[index].camera for index in train}
    return not capture.has_moving_cameras and 1 < len(cameras) < len(train)


def _hull(capture: Capture, store: Images, train: list[int]) -> VisualHull | None:
    """The subject's visual hull at some of the frames; None where there are no masks."""
    if not capture.has_masks or store.alpha(train[0]) is None:
        return None
    frames = sorted({capture.shots[index].frame for index in train})
    chosen = set(frames if len(frames) == len(train) else spread(frames, _HULL_FRAMES))
    return VisualHull(capture, store, [index for index in train if capture.shots[index].frame in chosen])


def _typical(near_far: tuple[float, float]) -> float:
    """The depth half-way in inverse depth, where most of a scene lies."""
    return 2 / (1 / near_far[0] + 1 / near_far[1])


def _references(capture: Capture, train: list[int]) -> list[int]:
    """Shots whose depth is measured: those of the middle frame, or of moving cameras some over all frames."""
    if capture.has_moving_cameras:
        return spread(train, _SWEEP_REFERENCES)
    frames = sorted({capture.shots[index].frame for index in train})
    middle = frames[len(frames) // 2]
    return spread([index for index in train if capture.shots[index].frame == middle], 2 * _SWEEP_REFERENCES)


def _candidates(capture: Capture, train: list[int], reference: int) -> list[int]:
    """Training shots that may show the same state of the scene: of the same frame, or all of moving cameras."""
    if capture.has_moving_cameras:
        return [index for index in train if index != reference]
    frame = capture.shots[reference].frame
    return [index for index in train if capture.shots[index].frame == frame and index != reference]


def _match(capture: Capture, store: Images, train: list[int], depth: float) -> Cloud:
    """Points triangulated from features, at some frames or between near ones."""
    if capture.has_moving_cameras:
        shots = spread(train, _MATCH_VIEWS // 2)
    else:
        frames = sorted({capture.shots[index].frame for index in train})
        chosen = set(spread(frames, 3 if 3 * len(train) <= len(frames) * _MATCH_VIEWS else 2))
        shots = [index for index in train if capture.shots[index].frame in chosen]
    partners = 2 if len(shots) > 20 else 3
    views: dict[int, View] = {}
    pairs = []
    for shot in shots:
        for other in neighbours(capture, shot, _candidates(capture, train, shot), depth, partners, best_angle=8.0):
            if (other, shot) in pairs:
                continue
            pairs.append((shot, other))
            for index in (shot, other):
                if index not in views:
                    views[index] = load_view(capture, store, index, _MATCH_SIDE)
    return triangulate((views[first], views[second]) for first, second in pairs)


def _depth_range(capture: Capture, points: Float64s, depth: float) -> tuple[float, float]:
    """Depth range to search: the capture's, else that of the matched points, else around ``depth``."""
    if capture.near_far is not None:
        return capture.near_far
    if len(points) >= 50:
        cameras = [capture.cameras[capture.shots[index].camera] for index in spread(capture.train_indices, 8)]
        depths = np.concatenate([camera.project(points)[1] for camera in cameras])
        low, high = np.percentile(depths[depths > 0], [2, 98])
        return 0.7 * float(low), 1.6 * float(high)
    return 0.3 * depth, 2.5 * depth


def _sweep(
    capture: Capture,
    store: Images,
    references: list[int],
    near_far: tuple[float, float],
    report: Callable[[int], None],
) -> tuple[Cloud, Bools]:
    """Points of all reference views whose depth a second view confirms, and whether (N,) they lie on structure."""
    views: dict[int, View] = {}
    maps: dict[int, DepthMap] = {}
    around: dict[int, list[int]] = {}
    train, depth = capture.train_indices, _typical(near_far)
    for done, reference in enumerate(references, start=1):
        around[reference] = neighbours(capture, reference, _candidates(capture, train, reference), depth, 4)
        for index in [reference, *around[reference]]:
            if index not in views:
                views[index] = load_view(capture, store, index, _SWEEP_SIDE)
        if around[reference]:
            others = [views[index] for index in around[reference]]
            maps[reference] = sweep(views[reference], others, *near_far)
        report(done)
    return _confirmed_points(capture, maps, depth)


def _confirmed_points(capture: Capture, maps: dict[int, DepthMap], depth: float) -> tuple[Cloud, Bools]:
    """See ``_sweep``; of few views with what one of them sees alone."""
    found: dict[int, ConfirmedDepth] = {}
    points, colors, textured = [np.zeros((0, 3))], [np.zeros((0, 3), np.float32)], [np.zeros(0, bool)]
    for reference, depth_map in maps.items():
        candidates = [index for index in maps if index != reference]
        near_by = neighbours(capture, reference, candidates, depth, 4, best_angle=4.0)
        others_maps = [maps[index] for index in near_by]
        # Stripes fit at several depths and flat walls at any: there two other views must agree.
        good = consistent(depth_map, others_maps, needed=2)
        good |= consistent(depth_map, others_maps) & depth_map.is_unique & depth_map.is_textured
        found[reference] = ConfirmedDepth(depth_map, good)
        chosen = np.flatnonzero(good)
        points.append(world_points(depth_map)[chosen])
        colors.append(depth_map.view.image.reshape(-1, 3)[chosen])
        textured.append(depth_map.is_textured.ravel()[chosen])
    is_few = len({capture.shots[index].camera for index in maps}) <= _FEW_VIEWS
    if is_few and not capture.has_moving_cameras and not capture.has_masks:  # depth would be carried off the subject
        for reference, confirmed in found.items():
            others = [other for index, other in found.items() if index != reference]
            places, their_colors, on_structure = points_seen_once(confirmed, others)
            points.append(places)
            colors.append(their_colors)
            textured.append(on_structure)
    return (np.concatenate(points), np.concatenate(colors)), np.concatenate(textured)


def _choose(textured: Bools, count: int, random: np.random.Generator) -> Ints:
    """Indices of at most 2 * count points, more of them on structure than on flat walls.

    Twice as many as wanted, because views overlap and the merging of duplicates will thin them.
    """
    on_structure, on_flat = random.permutation(np.flatnonzero(textured)), random.permutation(np.flatnonzero(~textured))
    flat = min(len(on_flat), max(int(2 * count * _UNTEXTURED_SHARE), 2 * count - len(on_structure)))
    chosen: Ints = np.concatenate([on_structure[: 2 * count - flat], on_flat[:flat]]).astype(int)
    return chosen


def merge_points(cloud: Cloud, centers: Float64s, count_limit: int) -> Cloud:
    """The first point of each voxel; voxels grow until no more than ``count_limit`` are filled.

    Voxels double in size with each doubling of the distance to the nearest camera, because near surfaces need more
    points. If voxels larger than the scene are still too many, a subset of their points is taken.
    """
    finite = np.isfinite(cloud[0]).all(axis=1)
    points, colors = cloud[0][finite], cloud[1][finite]
    centers = centers[np.linspace(0, len(centers) - 1, min(len(centers), 32)).astype(int)]
    distance = np.min([np.linalg.norm(points - center, axis=1) for center in centers], axis=0)
    level = np.round(np.log2(np.maximum(distance, 1e-9)))
    voxel, largest = 0.002, (np.abs(points) / 2 ** level[:, None]).max(initial=0.0)
    while True:
        cells = np.floor(points / (voxel * 2**level)[:, None]).clip(-(2**40), 2**40)
        keys = np.concatenate([cells, level[:, None]], axis=1).astype(np.int64)
        first = np.sort(np.unique(keys, axis=0, return_index=True)[1])
        if len(first) <= count_limit:
            return points[first], colors[first]
        if voxel > largest:
            some = first[np.linspace(0, len(first) - 1, count_limit).astype(int)]
            return points[some], colors[some]
        voxel *= 1.12


def _given_points(capture: Capture, store: Images, train: list[int]) -> tuple[Float64s, Float32s]:
    """The capture's own points (N, 3) that training images see, and their colours (N, 3) float32 in [0, 1].

    N is 0 for captures without points. A point's colour is the median over the views that it projects into, which is
    robust against occlusion in some of them.
    """
    points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    if capture.points is None or not len(capture.points):
        return points, colors
    points = capture.points[:: -(-len(capture.points) // _MOST_GIVEN)]
    values, seen = [], []
    for index in spread(train, _GIVEN_VIEWS):
        view = load_view(capture, store, index, _GIVEN_SIDE)
        value, is_seen = sample_view(view, points, view.image)
        values.append(np.where(is_seen[:, None], value, np.nan))
        seen.append(is_seen)
    kept = np.any(seen, axis=0)
    if kept.any():
        colors = np.nanmedian(np.array(values)[:, kept], axis=0).astype(np.float32)
    return points[kept], colors
