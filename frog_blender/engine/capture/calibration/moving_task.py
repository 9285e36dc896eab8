"""The child's task for moving cameras: images in order to a pose for each."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...io.plain_values import JsonObject
from .evidence import agreeing
from .moving_region import doubts, moving_share
from .moving_solve import solve_moving
from .rig_world import oriented
from .tracks import join
from .walk import Tell, walk_features, walk_of, walk_pairs
from .work_folder import WorkFolder

_MOST_POINTS = 8000


def moving(request: JsonObject, tell: Tell) -> JsonObject:
    """The poses of moving cameras, for a request by ``moving.calibrate_moving``.

    Raises:
        CalibrationRefused: if the images do not fix the poses.
        FrogError: for an image that cannot be read.
    """
    work = WorkFolder(Path(request["work"]))
    walks = [walk_of(entry) for entry in request["walks"]]
    features = walk_features(work, walks, tell)
    pairs = walk_pairs(work, walks, features, tell)
    pixels = [each.pixels for each in features]
    tracks = join(pairs, pixels)
    solution = solve_moving(walks, pixels, pairs, tracks, tell)
    adjusted = solution.adjusted
    share = moving_share(walks, features, adjusted.model, tell)
    model, points = oriented(adjusted.model, adjusted.points)
    agree = agreeing(adjusted, tracks)
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    sure = np.isfinite(points).all(axis=1) & (lengths >= 3)
    cameras = np.repeat(np.arange(len(walks)), [len(walk.images) for walk in walks])[model.placed].tolist()
    firsts = [model.placed[cameras.index(camera)] for camera in range(len(walks))]  # each has images with a pose
    return {
        "lenses": [asdict(model.lenses[first]) for first in firsts],
        "placed": model.placed,
        "poses": model.poses[model.placed].tolist(),
        "points": points[sure][:_MOST_POINTS].round(5).tolist(),
        "residual": float(np.median(adjusted.distances[agree])),
        "focal_uncertainty": solution.unsure,
        "halves_apart": solution.apart,
        "costs": list(solution.costs),
        "moving_share": share,
        "warnings": [*solution.warnings, *doubts(share)],
    }
