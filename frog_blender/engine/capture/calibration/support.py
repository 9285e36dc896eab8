"""What supports a model, camera by camera and pair by pair: the figures that checks and reports look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s
from .calibration import CalibratedCamera, Calibration, CameraSupport, PairSupport
from .colmap import Adjusted
from .model import oriented
from .structure import Solution, agreeing
from .tracks import Pairs, Tracks

_CELLS = np.array([8, 6])  # of an image, in which observations are counted
_MOST_POINTS = 8000


@dataclass(frozen=True, eq=False)
class Support:
    """What speaks for standing cameras.

    Attributes:
        names: of the cameras.
        cameras: none where no model was found.
        pairs: of all cameras.
    """

    names: Sequence[str]
    cameras: Sequence[CameraSupport]
    pairs: Sequence[PairSupport]


def support_of(solution: Solution, matches: Pairs, names: Sequence[str]) -> Support:
    """The support of standing cameras, by name; ``matches`` are those of their images."""
    cameras = [] if solution.adjusted is None else camera_support(solution.adjusted, solution.tracks)
    return Support(names, cameras, _pair_support(matches, solution, len(names)))


def camera_support(adjusted: Adjusted, tracks: Tracks) -> list[CameraSupport]:
    """What supports each camera."""
    agree = agreeing(adjusted, tracks)
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    found = []
    for camera, lens in enumerate(adjusted.model.lenses):
        own = tracks.cameras == camera
        good = own & agree
        cells = (tracks.pixels[good] / [lens.width, lens.height] * _CELLS).astype(int).clip(0, _CELLS - 1)
        found.append(
            CameraSupport(
                observations=int(good.sum()),
                share=float(good.sum() / max(own.sum(), 1)),
                shared_by_three=int((lengths[tracks.points[good]] >= 3).sum()),
                residual=float(np.median(adjusted.distances[good])) if good.any() else float("inf"),
                coverage=len(np.unique(cells, axis=0)) / float(_CELLS.prod()),
                focal_uncertainty=float(adjusted.uncertainty[camera]),
            )
        )
    return found


def _pair_support(matches: Pairs, solution: Solution, cameras: int) -> list[PairSupport]:
    """What supports each pair of cameras; without a model no match agrees with it."""
    together = np.zeros((cameras, cameras), np.int64)
    tracks = solution.tracks
    if solution.adjusted is not None:
        agree = agreeing(solution.adjusted, tracks)
        sees = np.zeros((tracks.count, cameras), np.int64)
        sees[tracks.points[agree], tracks.cameras[agree]] = 1
        together = sees.T @ sees
    return [
        PairSupport(one, other, len(found), len(solution.verified.get((one, other), ())), int(together[one, other]))
        for (one, other), found in sorted(matches.items())
    ]


def calibration_of(
    names: Sequence[str],
    adjusted: Adjusted,
    tracks: Tracks,
    supports: Sequence[CameraSupport],
    *,
    is_metric: bool = False,
) -> Calibration:
    """The cameras of a model and its points, in the world that they suggest.

    Args:
        names, supports: of the cameras.
        is_metric: lengths are metres, and stay so; otherwise the world's scale is chosen.
    """
    model, points = oriented(adjusted.model, adjusted.points, keep_scale=is_metric)
    agree = agreeing(adjusted, tracks)
    cameras = tuple(
        CalibratedCamera(lens.camera(name, pose), (lens.k1, lens.k2), support)
        for name, lens, pose, support in zip(names, model.lenses, model.poses, supports, strict=True)
    )
    return Calibration(cameras, sure_points(points, tracks, agree, 2), is_metric=is_metric)


def sure_points(points: Float64s, tracks: Tracks, agree: Bools, least: int) -> Float64s:
    """Those of the points (N, 3) that at least so many observations agree about, the best seen ones first.

    Args:
        agree: (observations,) whether an observation agrees with the model.
    """
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    sure = np.flatnonzero((lengths >= least) & np.isfinite(points).all(axis=1))
    best: Float64s = points[sure[np.argsort(-lengths[sure], kind="stable")][:_MOST_POINTS]]
    return best.round(5)
