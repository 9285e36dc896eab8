"""The child's task for standing cameras: views on disk to a calibration, each stage kept in the work folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...arrays import Array, ImageArray
from ...io.plain_values import JsonObject
from .calibration import CalibrationRefused
from .evidence import agreeing
from .features import BACKGROUND, Features, background_features, moment_features, pooled
from .films import View
from .orientation import oriented
from .solve import Solution, match_all, solve
from .tracks import Pairs
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
    views, keys = [], []
    for entry in listed:
        arrays = work.load("view", entry["key"])
        if arrays is None:
            raise FileNotFoundError(work.file("view", entry["key"]))
        views.append(view_of(entry, arrays))
        keys.append(str(entry["key"]))
    return views, keys


def arrays_of(view: View) -> dict[str, Array]:
    """A view's arrays for the work folder; ``view_of`` reads them back."""
    arrays: dict[str, Array] = {"plate": view.plate, "changing": view.changing, "shares": np.array(view.shares)}
    for kind, images in (("image", view.images), ("next", view.nexts)):
        arrays |= {f"{kind}{place}": image for place, image in enumerate(images) if image is not None}
    return arrays


def view_of(entry: JsonObject, arrays: dict[str, Array]) -> View:
    """The view of a request's entry and its arrays."""
    shares = tuple(arrays["shares"].tolist())

    def images(kind: str) -> tuple[ImageArray | None, ...]:
        return tuple(arrays.get(f"{kind}{place}") for place in range(len(shares)))

    return View(
        entry["name"],
        (int(entry["size"][0]), int(entry["size"][1])),
        arrays["plate"],
        arrays["changing"],
        images("image"),
        shares,
        images("next"),
        int(entry["group"]),
    )


def all_features(work: WorkFolder, views: Sequence[View], tell: Tell) -> list[Features]:
    """The pooled features of each view, image by image of an earlier run or new."""
    wanted = [(view, moment) for view in views for moment in range(BACKGROUND, len(view.images))]
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # pycolmap works outside Python's lock
        parts = []
        for place, part in enumerate(threads.map(lambda each: _features(work, *each), wanted)):
            tell("features", place, len(wanted))
            parts.append(part)
    own = iter(parts)
    return [pooled([next(own) for _ in range(len(view.images) + 1)]) for view in views]


def _features(work: WorkFolder, view: View, moment: int) -> Features:
    """Those of the background, or of a moment."""
    if moment == BACKGROUND:
        key = key_of(view.plate, view.changing)
    else:
        near, towards = view.images[moment], view.nexts[moment]
        missing = np.empty(0)
        key = key_of(
            missing if near is None else near,
            missing if towards is None else towards,
            view.shares[moment],
            view.changing,
            moment,
        )
    kept = work.load("features", key)
    if kept is None:
        found = background_features(view) if moment == BACKGROUND else moment_features(view, moment)
        kept = {"pixels": found.pixels, "descriptors": found.descriptors, "moments": found.moments}
        work.keep("features", key, kept)
    return Features(kept["pixels"], kept["descriptors"], kept["moments"])


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
    lengths = np.bincount(solution.tracks.points[agree], minlength=solution.tracks.count)
    sure = np.flatnonzero((lengths >= 2) & np.isfinite(points).all(axis=1))
    sure = sure[np.argsort(-lengths[sure], kind="stable")][:_MOST_POINTS]
    cameras = [
        {
            "name": name,
            "lens": asdict(lens),
            "pose": pose.tolist(),
            "evidence": asdict(evidence),
            "observations": _sample(solution, agree, index),
        }
        for index, (name, lens, pose, evidence) in enumerate(
            zip(names, model.lenses, model.poses, solution.cameras, strict=True)
        )
    ]
    return {
        "cameras": cameras,
        "points": points[sure].round(5).tolist(),
        "pairs": [asdict(pair) for pair in solution.pairs],
        "start": chosen.start,
        "own_focals": chosen.own,
        "costs": [each.cost for each in solution.hypotheses if each.adjusted is not None],
        "halves_apart": solution.halves_apart,
        "warnings": warnings(solution, names),
    }


def _sample(solution: Solution, agree: Array, camera: int) -> list[list[float]]:
    """Some of a camera's observations, for the report: x, y in pixels, and 1 where it agrees."""
    own = np.flatnonzero(solution.tracks.cameras == camera)
    own = own[:: max(1, len(own) // 400)]
    rows: list[list[float]] = np.column_stack([solution.tracks.pixels[own].round(1), agree[own]]).tolist()
    return rows
