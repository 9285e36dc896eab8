"""What supports a model, camera by camera and pair by pair: the figures that checks and reports look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s
from .calibration import CalibratedCamera, Calibration, CameraSupport, PairSupport
from .colmap import Adjusted
from .model import Model, oriented
from .structure import Images, Solution, agreeing
from .tracks import Pairs, Tracks

_CELLS = np.array([8, 6])  # of an image, in which observations are counted
_SHOWN = 400  # observations of a camera, for the report
_MOST_POINTS = 8000


@dataclass(frozen=True, eq=False)
class Support:
    """What speaks for standing cameras.

    Attributes:
        names: of the cameras.
        cameras: none where no model was found.
        pairs: of all cameras whose images were matched.
        connected: a walk-through connects the cameras, so that they need not see the same things.
    """

    names: Sequence[str]
    cameras: Sequence[CameraSupport]
    pairs: Sequence[PairSupport]
    connected: bool = False


def support_of(solution: Solution, images: Images, matches: Pairs, names: Sequence[str]) -> Support:
    """The support of the standing cameras, the first of the images, by name; ``matches`` are those of all images."""
    standing = images.standing
    connected = len(images.lenses) > standing
    cameras: Sequence[CameraSupport] = ()
    if solution.adjusted is not None:
        cameras = camera_support(solution.adjusted, solution.tracks, standing)
    return Support(names, cameras, _pair_support(matches, solution, standing), connected)


def camera_support(adjusted: Adjusted, tracks: Tracks, count: int) -> list[CameraSupport]:
    """What supports each of the first ``count`` cameras."""
    agree = agreeing(adjusted, tracks)
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    found = []
    for camera in range(count):
        lens = adjusted.model.lenses[camera]
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
    """What supports each pair of the first cameras; without a model no match agrees with it."""
    together = np.zeros((cameras, cameras), np.int64)
    tracks = solution.tracks
    if solution.adjusted is not None:
        agree: Bools = agreeing(solution.adjusted, tracks) & (tracks.cameras < cameras)
        sees = np.zeros((tracks.count, cameras), np.int64)
        sees[tracks.points[agree], tracks.cameras[agree]] = 1
        together = sees.T @ sees
    return [
        PairSupport(one, other, len(found), len(solution.verified.get((one, other), ())), int(together[one, other]))
        for (one, other), found in sorted(matches.items())
        if other < cameras
    ]


def calibration_of(
    names: Sequence[str],
    adjusted: Adjusted,
    tracks: Tracks,
    supports: Sequence[CameraSupport],
    *,
    least: int = 2,
    is_metric: bool = False,
) -> Calibration:
    """The first cameras of a model and its points, in the world that they suggest.

    Args:
        names, supports: of those cameras.
        least: observations that must agree about a point; the best seen ones come first.
        is_metric: lengths are metres, and stay so; otherwise the world's scale is chosen.
    """
    count = len(names)
    model = Model(adjusted.model.poses[:count], adjusted.model.lenses[:count])
    model, points = oriented(model, adjusted.points, keep_scale=is_metric)
    agree = agreeing(adjusted, tracks)
    cameras = []
    for index, (name, lens, pose) in enumerate(zip(names, model.lenses, model.poses, strict=True)):
        own = np.flatnonzero(tracks.cameras == index)
        own = own[:: max(1, len(own) // _SHOWN)]
        observations = np.column_stack([tracks.pixels[own].round(1), agree[own]]).astype(np.float64)
        cameras.append(CalibratedCamera(lens.camera(name, pose), (lens.k1, lens.k2), supports[index], observations))
    return Calibration(tuple(cameras), sure_points(points, tracks, agree, least), is_metric=is_metric)


def sure_points(points: Float64s, tracks: Tracks, agree: Bools, least: int) -> Float64s:
    """Those of the points (N, 3) that at least so many observations agree about, the best seen ones first.

    Args:
        agree: (observations,) whether an observation agrees with the model.
    """
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    sure = np.flatnonzero((lengths >= least) & np.isfinite(points).all(axis=1))
    best: Float64s = points[sure[np.argsort(-lengths[sure], kind="stable")][:_MOST_POINTS]]
    return best.round(5)
