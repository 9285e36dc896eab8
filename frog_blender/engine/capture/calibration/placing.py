"""Cameras from images: features, matches and structure from motion, in processes of their own, each stage kept."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...arrays import Array
from ...io.child_process import Progress
from ..readers.footage import state_of
from ..synchronization.run import CalibrationRefused, Run, WorkFolder, key_of
from .calibration import Calibration, MovingCamera
from .checks import (
    calibration_of,
    moving_refusal,
    moving_share,
    moving_warnings,
    refusal,
    support_of,
    sure_points,
    warnings,
)
from .features import Features, find_features, image_features, match_pairs, pairs_to_match, view_features
from .model import Lens, oriented
from .sequences import ImageSequence
from .structure import Images, Solution, agreeing, solve
from .tracks import Pairs
from .views import CameraFacts

_MOST_PROCESSES = 8  # each holds pycolmap and a camera's images


def place_views(run: Run, views: Sequence[CameraFacts]) -> Calibration:
    """The cameras of standing views.

    Raises:
        CalibrationRefused: if the views do not fix their cameras: why, and what to film next time.
        FrogError: if pycolmap is missing, or its process died.
    """
    missing = [view for view in views if not run.work.file("features", view.key).is_file()]
    count = min(_MOST_PROCESSES, os.cpu_count() or 1, len(missing))
    if count > 1:  # pycolmap finds features inside Python's lock
        parts = [missing[part::count] for part in range(count)]
        run.in_threads("features", lambda part: run.in_child(find_features, part, run.work), parts)
    return run.in_child(place_standing, views, run.work)


def place_standing(views: Sequence[CameraFacts], work: WorkFolder, tell: Progress) -> Calibration:
    """The standing cameras in their own world, in the child."""
    features = []
    for index, view in enumerate(views):
        tell("features", index, len(views))
        features.append(view_features(work, view))
    images = _images(features, [view.size for view in views], [view.group for view in views], may_differ=True)
    pairs = pairs_to_match(len(views))
    solution, matches = _solved(images, features, pairs, key_of([view.key for view in views]), work, tell)
    support = support_of(solution, matches, [view.name for view in views])
    if why := refusal(solution, support):
        raise CalibrationRefused(why)
    assert solution.adjusted is not None
    found = calibration_of(support.names, solution.adjusted, solution.tracks, support.cameras)
    told = tuple(warnings(solution, support))
    return replace(found, pairs=tuple(support.pairs), halves_apart=solution.halves_apart, warnings=told)


def place_moving(sequence: ImageSequence, work: WorkFolder, tell: Progress) -> MovingCamera:
    """A pose for each image of a moving camera that has one, and its lens, in the child.

    Raises:
        CalibrationRefused: if the images do not fix their camera.
        FrogError: for an image that cannot be read.
    """
    features, count = [], len(sequence.images)
    for index, path in enumerate(sequence.images):
        tell("features", index, count)
        features.append(image_features(work, path, sequence.size))
    images = _images(features, [sequence.size] * count, [0] * count)
    pairs = pairs_to_match(count, in_order=True)
    key = key_of([state_of(path) for path in sequence.images])
    solution, matches = _solved(images, features, pairs, key, work, tell)
    if why := moving_refusal(solution, count):
        raise CalibrationRefused(why)
    adjusted = solution.adjusted
    assert adjusted is not None
    share = moving_share(images, adjusted.model, matches)
    model, points = oriented(adjusted.model, adjusted.points)
    agree = agreeing(adjusted, solution.tracks)
    return MovingCamera(
        model.lenses[model.placed[0]],
        tuple(model.placed),
        model.poses[model.placed],
        sure_points(points, solution.tracks, agree, 3),
        float(np.median(adjusted.distances[agree])),
        float(adjusted.uncertainty[model.placed].max()),
        solution.halves_apart,
        tuple(moving_warnings(solution, count, share)),
    )


def _images(
    features: Sequence[Features], sizes: Sequence[tuple[int, int]], groups: Sequence[int], *, may_differ: bool = False
) -> Images:
    lenses = tuple(Lens(*size, 1.2 * size[0]) for size in sizes)
    return Images(lenses, tuple(groups), tuple(found.pixels for found in features), may_differ)


def _solved(
    images: Images,
    features: Sequence[Features],
    compared: Sequence[tuple[int, int]],
    key: str,
    work: WorkFolder,
    tell: Progress,
) -> tuple[Solution, Pairs]:
    """Structure from motion of images, and the matches of the compared pairs, which are kept under a key."""

    def matched() -> dict[str, Array]:
        matches, checked = match_pairs(features, images.lenses, compared, tell)
        return _flat(matches, "matches") | _flat(checked, "verified")

    kept = work.kept("pairs", key, matched)
    matches, checked = (
        dict(zip(compared, np.split(kept[name], kept[f"{name}_ends"]), strict=False))
        for name in ("matches", "verified")
    )
    return solve(images, matches, checked, tell), matches


def _flat(pairs: Pairs, name: str) -> dict[str, Array]:
    """Matches in two arrays: all of them, and where each pair's end."""
    found = list(pairs.values())
    ends = np.cumsum([len(matches) for matches in found])[:-1]
    return {name: np.concatenate([np.empty((0, 2), np.int64), *found]), f"{name}_ends": np.array(ends, np.int64)}
