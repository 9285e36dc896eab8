"""Seed points for the first Gaussians: points on the scene's surfaces, found from the training images alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Float32s, Float64s, Ints
from ..errors import FrogError
from .capture import Capture
from .hull import VisualHull
from .seeding.drawn import background_points, fill_volume, points_at_times, subject_points
from .seeding.matching import triangulate
from .seeding.plane_sweep import ConfirmedDepth, DepthMap, consistent, points_seen_once, sweep, world_points
from .seeding.views import Cloud, Images, TrainingImages, View, neighbours, sample_view, scene_depth, spread

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


def find_seeds(
    capture: Capture,
    store: Images,
    *,
    count_limit: int = 25_000,
    seed: int = 0,
    share: float = 1.0,
    num_moments: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
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
    images = TrainingImages(capture, store)
    if not images.train:
        raise FrogError(f"{capture.path}: every image is held out, expected some to train on.")
    random = np.random.default_rng(seed)
    references = _references(images)
    steps = len(references) + 2
    found, given = _match(images), _given_points(images)
    progress(1, steps)
    near_far = _depth_range(images, np.concatenate([found[0], given[0]]))
    moving = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    if num_moments and _hull_is_tight(images):
        most, own = int(_MOVING_SHARE * count_limit), np.random.default_rng((seed, 1))
        moving = points_at_times(images, near_far, most, num_moments, own)
    count_limit -= len(moving[0])
    swept, textured = _sweep(images, references, near_far, lambda done: progress(1 + done, steps))
    counts = {"matched": len(found[0]), "given": len(given[0]), "swept": len(swept[0])}
    measured = sum(counts.values())
    still = _merged(capture, (_joined(found, given), swept), textured, count_limit, random)
    if share < 1:
        still = _some_of(still, random.permutation(len(still[0]))[: int(share * count_limit)])
        measured = len(still[0])
    hull = _hull(images)
    if hull is not None:  # images of a subject over one colour match where there is nothing
        still = _some_of(still, np.flatnonzero(hull.contains(still[0])))
        measured = len(still[0])
    if measured < _ENOUGH:
        wanted = count_limit - len(still[0])
        if hull is not None:
            drawn = subject_points(images, hull, near_far, wanted, random)
        else:
            behind = 0 if sum(counts.values()) or not _has_film_of_several(images) else int(_BACKGROUND_SHARE * wanted)
            background = background_points(images, _BEHIND * near_far[1], behind, random) if behind else _nothing()
            counts["behind"] = len(background[0])
            still = _joined(still, background)
            drawn = fill_volume(images, near_far, wanted - counts["behind"], random)
        counts["drawn"] = len(drawn[0])
        still = _joined(still, drawn)
    progress(steps, steps)
    counts["moving"] = len(moving[2])
    points, colors = _joined(still, (moving[0], moving[1]))
    frames = np.concatenate([np.full(len(still[0]), np.nan), moving[2]]).astype(np.float32)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        if hull is not None:
            raise FrogError(f"{capture.path}: no point lies inside the masks of all cameras: are they of these images?")
        raise FrogError(f"{capture.path}: no point is seen by two training cameras: are the poses right?")
    return Seeds(
        points[finite].astype(np.float32),
        np.clip(colors[finite], 0, 1).astype(np.float32),
        ", ".join(f"{count} {name}" for name, count in counts.items() if count),
        frames[finite] if counts["moving"] else None,
    )


def _nothing() -> Cloud:
    return np.zeros((0, 3)), np.zeros((0, 3))


def _joined(*clouds: Cloud) -> Cloud:
    return np.concatenate([points for points, _ in clouds]), np.concatenate([colors for _, colors in clouds])


def _some_of(cloud: Cloud, chosen: Ints) -> Cloud:
    return cloud[0][chosen], cloud[1][chosen]


def _hull_is_tight(images: TrainingImages) -> bool:
    """Whether silhouettes of what moves before the background can tell where it is."""
    capture = images.capture
    is_many = len(capture.train_cameras) >= _FEWEST_CAMERAS
    return is_many and not capture.has_moving_cameras and not capture.has_masks


def _has_film_of_several(images: TrainingImages) -> bool:
    """Whether several static cameras have more than an image each."""
    return not images.capture.has_moving_cameras and 1 < len(images.capture.train_cameras) < len(images.train)


def _hull(images: TrainingImages) -> VisualHull | None:
    """The subject's visual hull at some of the frames; None where there are no masks."""
    capture, train = images.capture, images.train
    if not capture.has_masks or images.store.alpha(train[0]) is None:
        return None
    frames = sorted(images.by_frame)
    chosen = frames if len(frames) == len(train) else spread(frames, _HULL_FRAMES)
    return VisualHull(capture, images.store, [index for frame in chosen for index in images.by_frame[frame]])


def _typical(near_far: tuple[float, float]) -> float:
    """The depth half-way in inverse depth, where most of a scene lies."""
    return 2 / (1 / near_far[0] + 1 / near_far[1])


def _usual_depth(images: TrainingImages) -> float:
    """By the capture, or where its cameras look."""
    capture = images.capture
    if capture.near_far:
        return _typical(capture.near_far)
    return scene_depth([capture.cameras[capture.shots[index].camera] for index in images.train])


def _references(images: TrainingImages) -> list[int]:
    """Shots whose depth is measured: those of the middle frame, or of moving cameras some over all frames."""
    if images.capture.has_moving_cameras:
        return spread(images.train, _SWEEP_REFERENCES)
    return spread(images.middle, 2 * _SWEEP_REFERENCES)


def _near_by(images: TrainingImages, shot: int, depth: float, count: int, best_angle: float = 6.0) -> list[int]:
    """Training shots that may show the same state of the scene, of the same frame or all of moving cameras, from an
    angle good for measuring depth."""
    capture = images.capture
    candidates = images.train if capture.has_moving_cameras else images.by_frame[capture.shots[shot].frame]
    others = [index for index in candidates if index != shot]
    return neighbours(capture, shot, others, depth, count, best_angle=best_angle)


def _match(images: TrainingImages) -> Cloud:
    """Points triangulated from features, at some frames or between near ones."""
    capture, train, depth = images.capture, images.train, _usual_depth(images)
    if capture.has_moving_cameras:
        shots = spread(train, _MATCH_VIEWS // 2)
    else:
        frames = sorted(images.by_frame)
        chosen = spread(frames, 3 if 3 * len(train) <= len(frames) * _MATCH_VIEWS else 2)
        shots = [index for frame in chosen for index in images.by_frame[frame]]
    partners = 2 if len(shots) > 20 else 3
    pairs: list[tuple[int, int]] = []
    for shot in shots:
        others = _near_by(images, shot, depth, partners, best_angle=8.0)
        pairs += [(shot, other) for other in others if (other, shot) not in pairs]
    used = list(dict.fromkeys(shot for pair in pairs for shot in pair))
    views = dict(zip(used, images.views(used, _MATCH_SIDE), strict=True))
    return triangulate((views[first], views[second]) for first, second in pairs)


def _depth_range(images: TrainingImages, points: Float64s) -> tuple[float, float]:
    """Depth range to search: the capture's, else that of the matched points, else around the usual depth."""
    capture, depth = images.capture, _usual_depth(images)
    if capture.near_far is not None:
        return capture.near_far
    if len(points) >= 50:
        cameras = [capture.cameras[capture.shots[index].camera] for index in spread(images.train, 8)]
        depths = np.concatenate([camera.project(points)[1] for camera in cameras])
        low, high = np.percentile(depths[depths > 0], [2, 98])
        return 0.7 * float(low), 1.6 * float(high)
    return 0.3 * depth, 2.5 * depth


def _sweep(
    images: TrainingImages,
    references: list[int],
    near_far: tuple[float, float],
    report: Callable[[int], None],
) -> tuple[Cloud, Bools]:
    """Points of all reference views whose depth a second view confirms, and whether (N,) they lie on structure."""
    views: dict[int, View] = {}
    maps: dict[int, DepthMap] = {}
    depth = _typical(near_far)
    for done, reference in enumerate(references, start=1):
        others = _near_by(images, reference, depth, 4)
        needed = [index for index in (reference, *others) if index not in views]
        views |= zip(needed, images.views(needed, _SWEEP_SIDE), strict=True)
        if others:
            maps[reference] = sweep(views[reference], [views[index] for index in others], *near_far)
        report(done)
    return _confirmed_points(images.capture, maps, depth)


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


def _merged(
    capture: Capture, clouds: tuple[Cloud, Cloud], textured: Bools, count_limit: int, random: np.random.Generator
) -> Cloud:
    """At most ``count_limit`` of matched points and of swept ones, of which some are ``textured`` (N,)."""
    matched, swept = clouds
    if not len(matched[0]) + len(swept[0]):
        return _nothing()
    keep = _choose(textured, count_limit - min(len(matched[0]), count_limit // 3), random)
    some = random.permutation(len(matched[0]))[: count_limit // 3]
    centers = np.array([camera.center for camera in capture.cameras])
    return merge_points(_joined(_some_of(matched, some), _some_of(swept, keep)), centers, count_limit)


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


def _given_points(images: TrainingImages) -> Cloud:
    """The capture's own points that training images see, and their colours; none for captures without points.

    A point's colour is the median over the views that it projects into, which is robust against occlusion in some of
    them.
    """
    given = images.capture.points
    if given is None or not len(given):
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    points = given[:: -(-len(given) // _MOST_GIVEN)]
    views = images.views(spread(images.train, _GIVEN_VIEWS), _GIVEN_SIDE)
    values, seen = zip(*(sample_view(view, points, view.image) for view in views), strict=True)
    kept = np.any(seen, axis=0)
    colors = np.where(np.array(seen)[..., None], np.array(values), np.nan)[:, kept]
    return points[kept], np.nanmedian(colors, axis=0).astype(np.float32) if kept.any() else np.zeros((0, 3), np.float32)
