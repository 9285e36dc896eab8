"""The child's tasks: features of some images, and images with features to cameras in a world, stage by stage.

Each stage is kept in the work folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ...arrays import Array
from ...io.child_process import Progress
from ...io.plain_values import JsonObject
from ..synchronization import NamedTracks
from ..video import load_opencv
from .board import calibrate_board
from .board_detection import Board, Corners
from .calibration import CalibrationRefused
from .checks import moving_refusal, moving_share, moving_warnings, refusal, warnings
from .features import image_features, moment_features, view_features
from .films import View, view_of
from .joint_rig import calibrate_joints, calibrate_unsynchronised
from .matching import match_pairs, pairs_to_match
from .model import Lens, oriented
from .points import CameraFacts, calibrate_clicks
from .sequences import ImageSequence
from .structure import Images, Solution, agreeing, solve
from .support import calibration_of, support_of, sure_points
from .tracks import Pairs
from .work_folder import WorkFolder, key_of, key_of_file


def find_features(request: JsonObject, tell: Progress) -> JsonObject:
    """Keeps the features of a request's images: of each view (``placing.place_views``) those ``moments``."""
    load_opencv().setNumThreads(1)  # the other processors are taken by the other processes
    work = WorkFolder(Path(request["work"]))
    wanted = [(entry, int(moment)) for entry in request["views"] for moment in entry["moments"]]
    views = {entry["key"]: _view(work, entry) for entry in request["views"]}
    for index, (entry, moment) in enumerate(wanted):
        tell("features", index, len(wanted))
        moment_features(work, views[entry["key"]], moment)
    return {}


def place_images(request: JsonObject, tell: Progress) -> JsonObject:
    """The cameras of a request by ``placing``: of standing views, of image sequences, or of both in one world.

    Raises:
        CalibrationRefused: if the images do not fix their cameras.
        FrogError: for an image that cannot be read.
    """
    work = WorkFolder(Path(request["work"]))
    views = [_view(work, entry) for entry in request["views"]]
    sequences = [ImageSequence.of_plain(entry) for entry in request["sequences"]]
    files = [(path, sequence) for sequence in sequences for path in sequence.images]
    features = []
    for index, view in enumerate(views):
        tell("features", index, len(views) + len(files))
        features.append(view_features(work, view))
    for index, (path, sequence) in enumerate(files):
        tell("features", len(views) + index, len(views) + len(files))
        features.append(image_features(work, path, sequence.size))
    first = 1 + max((view.group for view in views), default=-1)  # a camera that moves may stabilise its images
    sizes = [view.size for view in views] + [sequence.size for _, sequence in files]
    images = Images(
        tuple(Lens(*size, 1.2 * size[0]) for size in sizes),
        (*(view.group for view in views), *(first + sequence.group for _, sequence in files)),
        tuple(found.pixels for found in features),
        len(views),
    )
    lengths = [1] * len(views) + [len(sequence.images) for sequence in sequences]
    key = key_of([entry["key"] for entry in request["views"]], [key_of_file(path) for path, _ in files], lengths)
    kept = work.load("pairs", key)
    if kept is None:
        kept = _plain(*match_pairs(features, images.lenses, pairs_to_match(lengths), tell))
        work.keep("pairs", key, kept)
    matches, verified = _pairs(kept)
    solution = solve(images, matches, verified, tell)
    if views:
        return _of_standing(solution, images, matches, [view.name for view in views])
    return _of_moving(solution, images, matches, [(sequence.name, len(sequence.images)) for sequence in sequences])


def place_by_clicks(request: JsonObject, tell: Progress) -> JsonObject:
    """The cameras of a request by ``placing.place_by_clicks``; CalibrationRefused if the points do not fix them."""
    tell("bundle adjustment", 0, 1)
    clicks = {name: np.array(points, np.float64) for name, points in request["clicks"].items()}
    return calibrate_clicks(_facts(request), request["groups"], clicks).plain()


def place_by_board(request: JsonObject, tell: Progress) -> JsonObject:
    """The cameras of a request by ``placing.place_by_board``; CalibrationRefused if the board does not fix them."""
    tell("bundle adjustment", 0, 1)
    corners = [[None if shown is None else _corners(*shown) for shown in found] for found in request["corners"]]
    return calibrate_board(_facts(request), Board(**request["board"]), corners).plain()


def place_by_joints(request: JsonObject, tell: Progress) -> JsonObject:
    """The cameras of a request by ``placing.place_by_joints``; CalibrationRefused if the joints do not fix them."""
    tell("bundle adjustment", 0, 1)
    return calibrate_joints(_facts(request), request["groups"], np.array(request["pixels"], np.float64)).plain()


def place_by_tracks(request: JsonObject, tell: Progress) -> JsonObject:
    """The cameras of a request by ``placing.place_by_tracks``, and the films' offsets in seconds; CalibrationRefused
    if the joints do not fix them."""
    tell("bundle adjustment", 0, 1)
    tracks = [
        NamedTracks(np.array(times, np.float64), np.array(positions, np.float64))
        for times, positions in request["tracks"]
    ]
    starts = [np.array(start, np.float64) for start in request["starts"]]
    found, offsets = calibrate_unsynchronised(_facts(request), request["groups"], tracks, starts, request["frame"])
    return {**found.plain(), "offsets": offsets.tolist()}


def _corners(numbers: Sequence[int], pixels: Sequence[Sequence[float]]) -> Corners:
    return Corners(np.array(numbers, np.int64), np.array(pixels, np.float64))


def _facts(request: JsonObject) -> list[CameraFacts]:
    return [CameraFacts(**entry) for entry in request["cameras"]]


def _view(work: WorkFolder, entry: JsonObject) -> View:
    """The view of a request's entry; FileNotFoundError if the caller did not keep it."""
    arrays = work.load("view", entry["key"])
    if arrays is None:
        raise FileNotFoundError(work.file("view", entry["key"]))
    return view_of(entry, arrays)


def _plain(matches: Pairs, verified: Pairs) -> dict[str, Array]:
    """Both of the same pairs, in few arrays; ``_pairs`` reads them back."""
    pairs = list(matches)
    lengths = [[len(matches[pair]), len(verified[pair])] for pair in pairs]
    none = [np.empty((0, 2), np.int64)]
    return {
        "pairs": np.array(pairs, np.int64).reshape(-1, 2),
        "lengths": np.array(lengths, np.int64).reshape(-1, 2),
        "matches": np.concatenate([*none, *(matches[pair] for pair in pairs)]),
        "verified": np.concatenate([*none, *(verified[pair] for pair in pairs)]),
    }


def _pairs(kept: Mapping[str, Array]) -> tuple[Pairs, Pairs]:
    pairs = [(one, other) for one, other in kept["pairs"].tolist()]
    ends = np.cumsum(kept["lengths"], axis=0)
    parts = (np.split(kept[name], ends[:-1, side]) for side, name in enumerate(("matches", "verified")))
    matches, verified = (dict(zip(pairs, part, strict=False)) for part in parts)
    return matches, verified


def _of_standing(solution: Solution, images: Images, matches: Pairs, names: Sequence[str]) -> JsonObject:
    """The standing cameras in their own world; the images of a walk-through only connect them."""
    support = support_of(solution, images, matches, names)
    if why := refusal(solution, support):
        raise CalibrationRefused(why)
    adjusted, tracks, chosen = solution.adjusted, solution.tracks, solution.chosen
    assert adjusted is not None and chosen is not None
    found = calibration_of(names, adjusted, tracks, support.cameras, least=3 if support.connected else 2)
    return replace(
        found,
        pairs=tuple(support.pairs),
        start=chosen.start,
        own_focals=chosen.own,
        costs=tuple(solution.costs),
        halves_apart=solution.halves_apart,
        warnings=tuple(warnings(solution, support)),
    ).plain()


def _of_moving(solution: Solution, images: Images, matches: Pairs, sequences: Sequence[tuple[str, int]]) -> JsonObject:
    """A pose for each image that has one, and a lens for each sequence."""
    if why := moving_refusal(solution, sequences):
        raise CalibrationRefused(why)
    adjusted = solution.adjusted
    assert adjusted is not None
    lengths = [count for _, count in sequences]
    share = moving_share(images, adjusted.model, matches, lengths)
    model, points = oriented(adjusted.model, adjusted.points)
    agree = agreeing(adjusted, solution.tracks)
    sequence_of = np.repeat(np.arange(len(lengths)), lengths)[model.placed].tolist()
    firsts = [model.placed[sequence_of.index(sequence)] for sequence in range(len(lengths))]  # each has images placed
    return {
        "lenses": [asdict(model.lenses[first]) for first in firsts],
        "placed": model.placed,
        "poses": model.poses[model.placed].tolist(),
        "points": sure_points(points, solution.tracks, agree, 3).round(5).tolist(),
        "residual": float(np.median(adjusted.distances[agree])),
        "focal_uncertainty": float(adjusted.uncertainty[model.placed].max()),
        "halves_apart": solution.halves_apart,
        "costs": solution.costs,
        "moving_share": share,
        "warnings": moving_warnings(solution, sequences, share),
    }
