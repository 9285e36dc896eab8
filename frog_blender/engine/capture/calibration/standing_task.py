"""The child's task for standing cameras: views on disk to a calibration, each stage kept in the work folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...arrays import Array, Bools, Float64s
from ...io.plain_values import JsonObject
from .calibration import CalibrationRefused
from .evidence import agreeing
from .feature_task import kept_features, loaded
from .features import BACKGROUND, Features, pooled
from .films import View
from .rig_world import oriented
from .solve import Solution, match_all, solve
from .tracks import Pairs, Tracks
from .verdict import refusal, warnings
from .work_folder import WorkFolder, key_of

Tell = Callable[[str, int, int], None]
_MOST_POINTS = 8000


def standing(request: JsonObject, tell: Tell) -> JsonObject:
    """The result of a request by ``standing.calibrate_standing``: cameras, points, evidence, warnings.

    Raises:
        CalibrationRefused: if the views do not fix their cameras.
    """
    work = WorkFolder(Path(request["work"]))
    views, keys = standing_views(work, request["views"])
    features = all_features(work, views, tell)
    pairs = standing_pairs(work, features, [view.size for view in views], keys, tell)
    solution = solve(features, [view.size for view in views], [view.group for view in views], pairs, tell)
    names = [view.name for view in views]
    if why := refusal(solution, names):
        raise CalibrationRefused(why)
    return _result(solution, names)


def standing_views(work: WorkFolder, listed: Sequence[JsonObject]) -> tuple[list[View], list[str]]:
    """The views of a request and their keys."""
    return [loaded(work, entry) for entry in listed], [str(entry["key"]) for entry in listed]


def all_features(work: WorkFolder, views: Sequence[View], tell: Tell) -> list[Features]:
    """The pooled features of each view, image by image of an earlier run or new."""
    parts = []
    for place, view in enumerate(views):
        tell("features", place, len(views))
        parts.append(pooled([kept_features(work, view, moment) for moment in range(BACKGROUND, len(view.images))]))
    return parts


def standing_pairs(
    work: WorkFolder, features: Sequence[Features], sizes: Sequence[tuple[int, int]], keys: list[str], tell: Tell
) -> tuple[Pairs, Pairs]:
    """Matches and verified matches, of an earlier run or new."""
    key = key_of(keys)
    kept = work.load("pairs", key)
    if kept is None:
        matches, checked = match_all(features, sizes, tell)
        kept = {f"{a} {b}": found for (a, b), found in matches.items()}
        kept |= {f"{a} {b} verified": found for (a, b), found in checked.items()}
        work.keep("pairs", key, kept)
    found: tuple[dict[tuple[int, int], Array], dict[tuple[int, int], Array]] = ({}, {})
    for name, array in kept.items():
        one, other, *is_checked = name.split()
        found[1 if is_checked else 0][int(one), int(other)] = array
    return found


def _result(solution: Solution, names: Sequence[str]) -> JsonObject:
    """A believed solution as plain values."""
    adjusted, chosen = solution.adjusted, solution.chosen
    assert adjusted is not None and chosen is not None
    model, points = oriented(adjusted.model, adjusted.points)
    agree = agreeing(adjusted, solution.tracks)
    cameras = [
        {
            "name": name,
            "lens": asdict(lens),
            "pose": pose.tolist(),
            "evidence": asdict(evidence),
            "observations": sampled_observations(solution.tracks, agree, index),
        }
        for index, (name, lens, pose, evidence) in enumerate(
            zip(names, model.lenses, model.poses, solution.cameras, strict=True)
        )
    ]
    return {
        "cameras": cameras,
        "points": sure_points(points, solution.tracks, agree, 2),
        "pairs": [asdict(pair) for pair in solution.pairs],
        "start": chosen.start,
        "own_focals": chosen.own,
        "costs": [each.cost for each in solution.hypotheses if each.adjusted is not None],
        "halves_apart": solution.halves_apart,
        "warnings": warnings(solution, names),
    }


def sure_points(points: Float64s, tracks: Tracks, agree: Bools, least: int) -> list[list[float]]:
    """Those of the points (N, 3) that at least so many observations agree about, the best seen ones first.

    Args:
        agree: (observations,) whether an observation agrees with the model.
    """
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    sure = np.flatnonzero((lengths >= least) & np.isfinite(points).all(axis=1))
    sure = sure[np.argsort(-lengths[sure], kind="stable")][:_MOST_POINTS]
    found: list[list[float]] = points[sure].round(5).tolist()
    return found


def sampled_observations(tracks: Tracks, agree: Bools, camera: int) -> list[list[float]]:
    """Some of a camera's observations, for the report: x, y in pixels, and 1 where it agrees."""
    own = np.flatnonzero(tracks.cameras == camera)
    own = own[:: max(1, len(own) // 400)]
    rows: list[list[float]] = np.column_stack([tracks.pixels[own].round(1), agree[own]]).tolist()
    return rows
