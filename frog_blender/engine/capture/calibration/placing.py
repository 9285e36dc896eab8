"""Cameras from images: features, matches and structure from motion, in processes of their own, each stage kept."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ...arrays import Array
from ...io.child_process import Progress
from ...io.work_folder import WorkFolder, key_of
from ..readers.footage import footage_at
from ..synchronization.films import CalibrationRefused, Film, Run
from . import checks
from .features import find_features, image_features, match_pairs, pairs_to_match, view_features
from .model import Calibration, Lens, MovingCamera, Pairs, oriented
from .sequences import ImageSequence
from .structure import Images, Solution, solve
from .views import CameraFacts, views_of

_MOST_PROCESSES = 8  # each holds pycolmap and a camera's images


def place_views(run: Run, views: Sequence[CameraFacts], sequences: Sequence[ImageSequence] = ()) -> Calibration:
    """The cameras of standing views.

    Args:
        sequences: walk-throughs of what the views show, which connect them.

    Raises:
        CalibrationRefused: if the views do not fix their cameras: why, and what to film next time.
        FrogError: if pycolmap is missing, or its process died.
    """
    missing = [view for view in views if not run.work.file("features", view.key).is_file()]
    processes = min(_MOST_PROCESSES, os.cpu_count() or 1, len(missing))
    if processes > 1:  # pycolmap finds features inside Python's lock
        parts = [missing[part::processes] for part in range(processes)]
        run.in_threads("features", lambda part: run.in_child(find_features, part, run.work), parts)
    return run.in_child(place_standing, views, sequences, run.work)


def place_films(run: Run, walks: Sequence[ImageSequence], films: Sequence[Film], count: int) -> Calibration:
    """The cameras of standing cameras' films, by what does not move and what moves at so many common times."""
    return place_views(run, views_of(run, films, count), walks)


def place_standing(
    views: Sequence[CameraFacts], sequences: Sequence[ImageSequence], work: WorkFolder, tell: Progress
) -> Calibration:
    """The standing cameras in their own world, in the child; the images of a walk-through only connect them."""
    solution, images, matches = _solved(views, sequences, work, tell)
    names = [view.name for view in views]
    if why := checks.refusal(solution, images, matches, names):
        raise CalibrationRefused(why)
    assert solution.adjusted is not None
    calibration = checks.calibration_of(names, solution.adjusted, least=3 if images.connected else 2)
    pairs = tuple(checks.pair_support(solution, images, matches))
    told = tuple(checks.warnings(solution, images, calibration.cameras))
    return replace(calibration, pairs=pairs, halves_apart=solution.halves_apart, warnings=told)


def place_moving(sequence: ImageSequence, work: WorkFolder, tell: Progress) -> MovingCamera:
    """A pose for each image of a moving camera that has one, and its lens, in the child.

    Raises:
        CalibrationRefused: if the images do not fix their camera.
        FrogError: for an image that cannot be read.
    """
    solution, images, matches = _solved((), [sequence], work, tell)
    if why := checks.moving_refusal(solution, len(images.lenses)):
        raise CalibrationRefused(why)
    adjusted = solution.adjusted
    assert adjusted is not None
    share = checks.moving_share(images, adjusted.model, matches)
    model, points = oriented(adjusted.model, adjusted.points)
    return MovingCamera(
        model.lenses[model.placed[0]],
        tuple(model.placed),
        model.poses[model.placed],
        points[adjusted.sure_points(3)].round(4),
        float(np.median(adjusted.distances[adjusted.agree])),
        adjusted.unsure,
        solution.halves_apart,
        tuple(checks.moving_warnings(solution, len(images.lenses), share)),
    )


def _solved(
    views: Sequence[CameraFacts], sequences: Sequence[ImageSequence], work: WorkFolder, tell: Progress
) -> tuple[Solution, Images, Pairs]:
    """Structure from motion of standing views, of image sequences, or of both in one world; and the matches."""
    files = [(path, sequence) for sequence in sequences for path in sequence.images]
    asked = [partial(view_features, work, view) for view in views]
    asked += [partial(image_features, work, path, sequence.size) for path, sequence in files]
    features = []
    for index, ask in enumerate(asked):
        tell("features", index, len(asked))
        features.append(ask())
    first = 1 + max((view.group for view in views), default=-1)  # a camera that moves may stabilise its images
    sizes = [view.size for view in views] + [sequence.size for _, sequence in files]
    images = Images(
        tuple(Lens(*size, 1.2 * size[0]) for size in sizes),
        (*(view.group for view in views), *(first + sequence.group for _, sequence in files)),
        tuple(own.pixels for own in features),
        len(views),
    )
    lengths = [1] * len(views) + [len(sequence.images) for sequence in sequences]
    compared = pairs_to_match(lengths)

    def matched() -> dict[str, Array]:
        matches, checked = match_pairs(features, images.lenses, compared, tell)
        return _flat(matches, "matches") | _flat(checked, "verified")

    key = key_of([view.key for view in views], [footage_at(path).state for path, _ in files], lengths)
    kept = work.kept("pairs", key, matched)
    matches, checked = (
        dict(zip(compared, np.split(kept[name], kept[f"{name}_ends"]), strict=False))
        for name in ("matches", "verified")
    )
    return solve(images, matches, checked, tell), images, matches


def _flat(pairs: Pairs, name: str) -> dict[str, Array]:
    """Matches in two arrays: all of them, and where each pair's end."""
    rows = list(pairs.values())
    ends = np.cumsum([len(matches) for matches in rows])[:-1]
    return {name: np.concatenate([np.empty((0, 2), np.int64), *rows]), f"{name}_ends": np.array(ends, np.int64)}
