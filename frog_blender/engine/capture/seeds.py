"""Seed points for the first Gaussians: points on the scene's surfaces, found from the training images alone."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Float32s, Float64s, Ints
from ..errors import CaptureRefused
from .capture import Capture, Images
from .hull import VisualHull
from .seeding.drawn import NearFar, background_points, fill_volume, points_at_times, subject_points
from .seeding.matching import Features, describe, triangulate_pair
from .seeding.plane_sweep import DepthMap, agreeing, points_seen_once, sweep
from .seeding.views import Cloud, TrainingImages, View, cloud_of, depth_range, joined, neighbours, scene_depth, spread

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


@dataclass(frozen=True)
class SeedSettings:
    """Which points are sought.

    Attributes:
        count_limit: at most this many points.
        seed: of what is drawn.
        share: of ``count_limit``, the maximum number of measured points, as if matching had found no more.
        num_moments: frames at which what moves before many static cameras gets points of its own, as far as there is
            any.
    """

    count_limit: int = 25_000
    seed: int = 0
    share: float = 1.0
    num_moments: int = 0


def find_seeds(
    capture: Capture,
    store: Images,
    settings: SeedSettings,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Seeds:
    """Seed points from matched features and a plane sweep, or from the common volume where views are too far apart.

    Points that came with the capture count as matched ones.

    Only training shots are read; the same input and settings give the same points.

    Args:
        progress: called with (steps done, steps in all).

    Raises:
        FrogError: if no training image is left, or no point is seen by the cameras.
    """
    images = TrainingImages(capture, store)
    if not images.train:
        raise CaptureRefused(f"{capture.path}: every image is held out, expected some to train on.")
    random = np.random.default_rng(settings.seed)
    # Shots whose depth is measured: those of the middle frame, or of moving cameras some over all frames.
    among, most = (images.train, 1) if capture.has_moving_cameras else (images.middle, 2)
    references = spread(among, most * _SWEEP_REFERENCES)
    to_match = max(1, 2 * len(references) // 3)  # matching takes as long as so many sweeps
    steps = to_match + len(references) + 1
    matching = _match(images, lambda share: progress(int(share * to_match), steps))
    parts = {"matched": matching, "given": _given_points(images)}
    progress(to_match, steps)
    matched = joined(parts.values())
    near_far = _depth_range(images, matched.points)
    parts["swept"] = _sweep(images, references, near_far, lambda done: progress(to_match + done, steps))
    moving = _moving(images, near_far, settings)
    count = settings.count_limit - len(moving)
    still = _merged(capture, matched, parts["swept"], count, random)
    if settings.share < 1:
        still = still[random.permutation(len(still))[: int(settings.share * count)]]
    hull = _hull(images)
    if hull is not None:  # images of a subject over one colour match where there is nothing
        still = still[hull.contains(still.points)]
    measured = sum(map(len, parts.values()))
    if (measured if hull is None and settings.share == 1 else len(still)) < _ENOUGH:
        drawn = _drawn(images, near_far, count - len(still), random, hull=hull, is_alone=not measured)
        parts |= drawn
        still = joined([still, *drawn.values()])
    progress(steps, steps)
    parts["moving"] = moving
    cloud = joined([still, moving])
    cloud = cloud[np.isfinite(cloud.points).all(axis=1)]
    if not len(cloud):
        if hull is not None:
            raise CaptureRefused(
                f"{capture.path}: no point lies inside the masks of all cameras: are they of these images?"
            )
        raise CaptureRefused(f"{capture.path}: no point is seen by two training cameras: are the poses right?")
    return Seeds(
        cloud.points.astype(np.float32),
        np.clip(cloud.colors, 0, 1).astype(np.float32),
        ", ".join(f"{len(part)} {name}" for name, part in parts.items() if len(part)),
        cloud.frames.astype(np.float32) if len(moving) else None,
    )


def _moving(images: TrainingImages, near_far: NearFar, settings: SeedSettings) -> Cloud:
    """Points on what moves, at times of their own, where silhouettes before the background can tell where it is."""
    capture = images.capture
    is_tight = len(capture.train_cameras) >= _FEWEST_CAMERAS and not capture.has_moving_cameras
    if not (settings.num_moments and is_tight) or capture.has_masks:
        return joined([])
    most, random = int(_MOVING_SHARE * settings.count_limit), np.random.default_rng((settings.seed, 1))
    return points_at_times(images, near_far, most, settings.num_moments, random)


def _drawn(
    images: TrainingImages,
    near_far: NearFar,
    count: int,
    random: np.random.Generator,
    *,
    hull: VisualHull | None,
    is_alone: bool,
) -> dict[str, Cloud]:
    """At most ``count`` points where too few were measured; ``is_alone`` where none was."""
    if hull is not None:
        return {"drawn": subject_points(images, hull, near_far, count, random)}
    capture, behind = images.capture, joined([])
    is_film_of_several = not capture.has_moving_cameras and 1 < len(capture.train_cameras) < len(images.train)
    if is_alone and is_film_of_several:
        behind = background_points(images, _BEHIND * near_far[1], int(_BACKGROUND_SHARE * count), random)
    return {"behind": behind, "drawn": fill_volume(images, near_far, count - len(behind), random)}


def _hull(images: TrainingImages) -> VisualHull | None:
    """The subject's visual hull at some of the frames; None where there are no masks."""
    capture, train = images.capture, images.train
    if not capture.has_masks or images.store.alpha(train[0]) is None:
        return None
    frames = sorted(images.by_frame)
    chosen = frames if len(frames) == len(train) else spread(frames, _HULL_FRAMES)
    return VisualHull(capture, images.store, [index for frame in chosen for index in images.by_frame[frame]])


def _typical(near_far: NearFar) -> float:
    """The depth half-way in inverse depth, where most of a scene lies."""
    return 2 / (1 / near_far[0] + 1 / near_far[1])


def _usual_depth(images: TrainingImages) -> float:
    """By the capture, or where its cameras look."""
    capture = images.capture
    if capture.near_far:
        return _typical(capture.near_far)
    return scene_depth([capture.cameras[capture.shots[index].camera] for index in images.train])


def _near_by(images: TrainingImages, shot: int, depth: float, count: int, best_angle: float = 6.0) -> list[int]:
    """Training shots that may show the same state of the scene, of the same frame or all of moving cameras, from an
    angle good for measuring depth."""
    capture = images.capture
    candidates = images.train if capture.has_moving_cameras else images.by_frame[capture.shots[shot].frame]
    others = [index for index in candidates if index != shot]
    return neighbours(capture, shot, others, depth, count, best_angle=best_angle)


def _match(images: TrainingImages, report: Callable[[float], None]) -> Cloud:
    """Points triangulated from features, at some frames or between near ones; reports the share that is done."""
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
    features, clouds = dict[int, Features](), list[Cloud]()
    for shot, view in views.items():
        report(len(features) / (len(views) + len(pairs)))
        features[shot] = describe(view)
    for a, b in pairs:
        report((len(views) + len(clouds)) / (len(views) + len(pairs)))
        clouds.append(triangulate_pair(views[a], views[b], (features[a], features[b])))
    return joined(clouds)


def _depth_range(images: TrainingImages, points: Float64s) -> NearFar:
    """Depth range to search: the capture's, else that of the matched points, else around the usual depth."""
    capture, depth = images.capture, _usual_depth(images)
    cameras = [capture.cameras[capture.shots[index].camera] for index in spread(images.train, 8)]
    return capture.near_far or depth_range(cameras, points) or (0.3 * depth, 2.5 * depth)


def _sweep(images: TrainingImages, references: list[int], near_far: NearFar, report: Callable[[int], None]) -> Cloud:
    """Points of all reference views whose depth a second view confirms."""
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


def _confirmed_points(capture: Capture, maps: dict[int, DepthMap], depth: float) -> Cloud:
    """See ``_sweep``; of few views with what one of them sees alone."""
    confirmed: dict[int, DepthMap] = {}
    for reference, depth_map in maps.items():
        candidates = [index for index in maps if index != reference]
        others = [maps[index] for index in neighbours(capture, reference, candidates, depth, 4, best_angle=4.0)]
        # Stripes fit at several depths and flat walls at any: there two other views must agree.
        votes = agreeing(depth_map, others)
        good = (votes > 1) | (votes > 0) & depth_map.is_unique & depth_map.is_textured
        confirmed[reference] = replace(depth_map, confirmed=good)
    clouds = [depth_map.cloud(depth_map.confirmed) for depth_map in confirmed.values()]
    is_few = len({capture.shots[index].camera for index in maps}) <= _FEW_VIEWS
    if is_few and not capture.has_moving_cameras and not capture.has_masks:  # depth would be carried off the subject
        for reference, depth_map in confirmed.items():
            others = [other for index, other in confirmed.items() if index != reference]
            clouds.append(points_seen_once(depth_map, others))
    return joined(clouds)


def _merged(capture: Capture, matched: Cloud, swept: Cloud, count_limit: int, random: np.random.Generator) -> Cloud:
    """At most ``count_limit`` of matched points and of swept ones."""
    if not len(matched) + len(swept):
        return matched
    keep = _choose(swept.is_textured, count_limit - min(len(matched), count_limit // 3), random)
    some = random.permutation(len(matched))[: count_limit // 3]
    centers = np.array([camera.center for camera in capture.cameras])
    return merge_points(joined([matched[some], swept[keep]]), centers, count_limit)


def _choose(textured: Bools, count: int, random: np.random.Generator) -> Ints:
    """Indices of at most 2 * count points, more of them on structure than on flat walls.

    Twice as many as wanted, because views overlap and the merging of duplicates will thin them.
    """
    on_structure, on_flat = random.permutation(np.flatnonzero(textured)), random.permutation(np.flatnonzero(~textured))
    flat = min(len(on_flat), max(int(2 * count * _UNTEXTURED_SHARE), 2 * count - len(on_structure)))
    return np.asarray(np.concatenate([on_structure[: 2 * count - flat], on_flat[:flat]]).astype(int))


def merge_points(cloud: Cloud, centers: Float64s, count_limit: int) -> Cloud:
    """The first point of each voxel; voxels grow until no more than ``count_limit`` are filled.

    Voxels double in size with each doubling of the distance to the nearest camera, because near surfaces need more
    points. If voxels larger than the scene are still too many, a subset of their points is taken.
    """
    cloud = cloud[np.isfinite(cloud.points).all(axis=1)]
    points = cloud.points
    centers = centers[np.linspace(0, len(centers) - 1, min(len(centers), 32)).astype(int)]
    distance = np.min([np.linalg.norm(points - center, axis=1) for center in centers], axis=0)
    level = np.round(np.log2(np.maximum(distance, 1e-9)))
    voxel, largest = 0.002, (np.abs(points) / 2 ** level[:, None]).max(initial=0.0)
    while True:
        cells = np.floor(points / (voxel * 2**level)[:, None]).clip(-(2**40), 2**40)
        keys = np.concatenate([cells, level[:, None]], axis=1).astype(np.int64)
        first = np.sort(np.unique(keys, axis=0, return_index=True)[1])
        if len(first) <= count_limit:
            return cloud[first]
        if voxel > largest:
            return cloud[first[np.linspace(0, len(first) - 1, count_limit).astype(int)]]
        voxel *= 1.12


def _given_points(images: TrainingImages) -> Cloud:
    """The capture's own points that training images see, and their colours; none for captures without points.

    A point's colour is the median over the views that it projects into, which is robust against occlusion in some of
    them.
    """
    given = images.capture.points
    if given is None or not len(given):
        return joined([])
    points = given[:: -(-len(given) // _MOST_GIVEN)]
    views = images.views(spread(images.train, _GIVEN_VIEWS), _GIVEN_SIDE)
    values, seen = zip(*(view.camera.sample(points, view.image) for view in views), strict=True)
    kept = np.any(seen, axis=0)
    if not kept.any():
        return joined([])
    colors = np.where(np.array(seen)[..., None], np.array(values), np.nan)[:, kept]
    return cloud_of(points[kept], np.nanmedian(colors, axis=0))
