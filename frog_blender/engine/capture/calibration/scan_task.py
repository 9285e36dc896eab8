"""The child's task for standing cameras beside walk-throughs of the set: both in one world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ...io.plain_values import JsonObject
from .adjustment import Adjusted
from .calibration import CalibrationRefused
from .evidence import CameraEvidence, agreeing, closing_triangles, of_cameras, of_pairs
from .features import Features
from .lens import Lens
from .mapping import Model
from .moving_solve import solve_moving
from .rig_world import oriented
from .scan_solve import Joined, joined, placed
from .scan_verdict import refusal, unplaced, warnings
from .standing_task import all_features, sampled_observations, standing_pairs, standing_views, sure_points
from .tracks import Pairs, Tracks, join
from .walk import Tell, Walk, across, walk_features, walk_of, walk_pairs
from .work_folder import WorkFolder, key_of, key_of_file

_WITNESSES = 6  # images of a walk-through whose triangles with a standing camera must close


def scan(request: JsonObject, tell: Tell) -> JsonObject:
    """The result of a request by ``standing.calibrate_standing`` with walk-throughs: as of ``standing_task.standing``.

    Raises:
        CalibrationRefused: if the walk-through, or it and the views, do not fix the cameras.
        FrogError: for an image that cannot be read.
    """
    work = WorkFolder(Path(request["work"]))
    views, keys = standing_views(work, request["views"])
    walks = [walk_of(entry) for entry in request["walks"]]
    walked = walk_features(work, walks, tell)
    between = walk_pairs(work, walks, walked, tell)
    pixels = [each.pixels for each in walked]
    try:
        world = solve_moving(walks, pixels, between, join(between, pixels), tell)
    except CalibrationRefused as error:
        films = ", ".join(walk.name for walk in walks)
        raise CalibrationRefused(f"The walk-through {films} has no world of its own: {error}") from error
    features = all_features(work, views, tell)
    matches, checked = standing_pairs(work, features, [view.size for view in views], keys, tell)
    standing = [Lens(*view.size, 1.2 * view.size[0]) for view in views]
    count = len(views)
    pairs = {
        **checked,
        **{(one + count, other + count): found for (one, other), found in between.items()},
        **_held(work, (standing, features, keys), (walks, walked), tell),
    }
    everything = [*(each.pixels for each in features), *pixels]
    tracks = join(pairs, everything)
    start = placed(standing, world, tracks)
    names = [view.name for view in views]
    if lost := [index for index in range(count) if index not in start.placed]:
        raise CalibrationRefused(unplaced(names, lost, pairs))
    tell("bundle adjustment", 0, 1)
    groups = [*(view.group for view in views), *_groups(walks, 1 + max(view.group for view in views))]
    found = joined(start, count, tracks, groups, world)
    evidence = _evidence(found, tracks, everything, pairs, count)
    if why := refusal(found, evidence, names):
        raise CalibrationRefused(why)
    stood = _standing_alone(found.adjusted, tracks, count)
    seen = [asdict(pair) for pair in of_pairs(matches, checked, *stood)]
    return _result(found, tracks, names, evidence) | {
        "pairs": seen,
        "start": 0.0,
        "own_focals": found.own_focals,
        "costs": [found.cost],
        "halves_apart": found.apart,
        "warnings": warnings(found, evidence, names),
    }


def _groups(walks: Sequence[Walk], first: int) -> list[int]:
    """The groups of the walks' images: never a standing camera's, for a camera that moves may stabilise its images."""
    return [first + walk.group for walk in walks for _ in walk.images]


def _held(
    work: WorkFolder,
    standing: tuple[Sequence[Lens], Sequence[Features], Sequence[str]],
    walked: tuple[Sequence[Walk], Sequence[Features]],
    tell: Tell,
) -> Pairs:
    """Verified matches between standing cameras and the walk-throughs' images, of an earlier run or new."""
    lenses, features, keys = standing
    walks, images = walked
    key = key_of(list(keys), [key_of_file(path) for walk in walks for path in walk.images])
    kept = work.load("held", key)
    if kept is None:
        every = [*lenses, *(Lens(*walk.size, 1.2 * walk.size[0]) for walk in walks for _ in walk.images)]
        starts = np.cumsum([len(lenses), *(len(walk.images) for walk in walks)]).tolist()
        found: dict[tuple[int, int], Ints] = {}
        for index in range(len(lenses)):
            for start, end in pairwise(starts):
                found |= across(every, [*features, *images], [index], range(start, end), tell)
        kept = {f"{one} {other}": each for (one, other), each in found.items()}
        work.keep("held", key, kept)
    return {(int(name.split()[0]), int(name.split()[1])): array for name, array in kept.items()}


def _evidence(
    found: Joined, tracks: Tracks, pixels: Sequence[Float64s], pairs: Pairs, count: int
) -> list[CameraEvidence]:
    """What supports each standing camera; its triangles are those with a few images of the walk-through."""
    model = found.adjusted.model
    closing = np.full(len(model.lenses), np.nan)
    for index in range(count):
        near = sorted((pair for pair in pairs if index in pair), key=lambda pair: -len(pairs[pair]))
        chosen = [index, *(next(iter({*pair} - {index})) for pair in near[: 2 * _WITNESSES : 2])]
        among = {pair: pairs[pair] for pair in combinations(sorted(chosen), 2) if pair in pairs}
        closing[index] = closing_triangles(model.lenses, pixels, among)[index]
    return of_cameras(found.adjusted, tracks, closing)[:count]


def _standing_alone(adjusted: Adjusted, tracks: Tracks, count: int) -> tuple[Adjusted, Tracks]:
    """The model and the observations of the standing cameras alone; the points stay."""
    own: Bools = tracks.cameras < count
    model = Model(adjusted.model.poses[:count], adjusted.model.lenses[:count])
    alone = Tracks(tracks.points[own], tracks.cameras[own], tracks.features[own], tracks.pixels[own], tracks.count)
    return Adjusted(model, adjusted.points, adjusted.distances[own], adjusted.uncertainty[:count]), alone


def _result(found: Joined, tracks: Tracks, names: Sequence[str], evidence: Sequence[CameraEvidence]) -> JsonObject:
    """The cameras and the points, those that most images see first, in the standing cameras' world."""
    stood, own = _standing_alone(found.adjusted, tracks, len(names))
    model, points = oriented(stood.model, stood.points)
    agree = agreeing(found.adjusted, tracks)
    agrees = agreeing(replace(stood, model=model), own)
    cameras = []
    for index, (name, lens, pose, each) in enumerate(zip(names, model.lenses, model.poses, evidence, strict=True)):
        observations = sampled_observations(own, agrees, index)
        entry = {"name": name, "lens": asdict(lens), "pose": pose.tolist(), "evidence": asdict(each)}
        cameras.append(entry | {"observations": observations})
    return {"cameras": cameras, "points": sure_points(points, tracks, agree, 3)}
