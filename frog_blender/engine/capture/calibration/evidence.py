"""What supports a model, camera by camera and pair by pair: the figures that the verdict and the report look at."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ...arrays import Bools, Float64s
from .adjustment import Adjusted
from .lens import Lens
from .mapping import Model
from .tracks import Pairs, Tracks
from .two_view import relative_rotation

CLOSES = 3.0
"""Degrees within which the rotations around a triangle of cameras must close."""
_CELLS = (8, 6)


@dataclass(frozen=True)
class CameraEvidence:
    """What supports one camera.

    Attributes:
        observations: that agree with the model.
        share: of its observations that agree.
        shared_by_three: points that it sees together with two others at once.
        residual: median, pixels.
        coverage: share of 8 x 6 cells of its image that hold an observation.
        focal_uncertainty: standard deviation of the focal length over the focal length.
        closing: share of its triangles of cameras whose rotations close; NaN without triangles.
    """

    observations: int
    share: float
    shared_by_three: int
    residual: float
    coverage: float
    focal_uncertainty: float
    closing: float


@dataclass(frozen=True)
class PairEvidence:
    """Two cameras by index: their matches, those that pass the two-view check, and those that agree with the model."""

    one: int
    other: int
    matches: int
    verified: int
    agreeing: int


def of_cameras(adjusted: Adjusted, tracks: Tracks, closing: Float64s) -> list[CameraEvidence]:
    """The evidence for each camera.

    Args:
        closing: (cameras,) as of ``closing_triangles``.
    """
    lenses = adjusted.model.lenses
    agree = agreeing(adjusted, tracks)
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    found = []
    for camera, lens in enumerate(lenses):
        own = tracks.cameras == camera
        good = own & agree
        cells = (tracks.pixels[good] / [lens.width, lens.height] * _CELLS).astype(int).clip(0, np.array(_CELLS) - 1)
        found.append(
            CameraEvidence(
                int(good.sum()),
                float(good.sum() / max(own.sum(), 1)),
                int((lengths[tracks.points[good]] >= 3).sum()),
                float(np.median(adjusted.distances[good])) if good.any() else float("inf"),
                len(np.unique(cells, axis=0)) / (_CELLS[0] * _CELLS[1]),
                float(adjusted.uncertainty[camera]),
                float(closing[camera]),
            )
        )
    return found


def agreeing(adjusted: Adjusted, tracks: Tracks) -> Bools:
    """(N,) which observations lie within the limit of a point that is located."""
    limits = np.array([lens.limit for lens in adjusted.model.lenses])
    return np.asarray(adjusted.distances <= limits[tracks.cameras])


def closing_triangles(lenses: Sequence[Lens], pixels: Sequence[Float64s], pairs: Pairs) -> Float64s:
    """(cameras,) share of the triangles of each camera whose rotations, found pair by pair, close within CLOSES.

    NaN for a camera in no triangle of pairs that match.
    """
    turns: dict[tuple[int, int], Float64s] = {}
    matched = [pair for pair, matches in pairs.items() if len(matches)]

    def of_pair(pair: tuple[int, int]) -> Float64s | None:
        one, other = pair
        return relative_rotation(lenses[one], pixels[one], lenses[other], pixels[other], pairs[pair])

    with ThreadPoolExecutor(os.cpu_count()) as threads:  # pycolmap estimates outside Python's lock
        for pair, turn in zip(matched, threads.map(of_pair, matched), strict=True):
            if turn is not None:
                turns[pair] = turn
    closed, all_ = np.zeros(len(lenses)), np.zeros(len(lenses))
    for a, b, c in combinations(range(len(lenses)), 3):
        if (a, b) in turns and (b, c) in turns and (a, c) in turns:
            angle = _degrees(turns[b, c] @ turns[a, b] @ turns[a, c].T)
            all_[[a, b, c]] += 1
            closed[[a, b, c]] += angle <= CLOSES
    with np.errstate(invalid="ignore"):
        shares: Float64s = closed / all_
    return shares


def of_pairs(matches: Pairs, verified: Pairs, adjusted: Adjusted | None, tracks: Tracks) -> list[PairEvidence]:
    """The evidence for each pair that has matches; without a model no match agrees with it."""
    cameras = 1 + max((max(pair) for pair in matches), default=0)
    together = np.zeros((cameras, cameras), np.int64)
    if adjusted is not None:
        agree = agreeing(adjusted, tracks)
        sees = np.zeros((tracks.count, cameras), np.int64)
        sees[tracks.points[agree], tracks.cameras[agree]] = 1
        together = sees.T @ sees
    return [
        PairEvidence(one, other, len(found), len(verified.get((one, other), ())), int(together[one, other]))
        for (one, other), found in sorted(matches.items())
    ]


def disagreement(one: Model, other: Model) -> float:
    """How far the cameras of two models lie apart at worst, over the rig's diameter, after similarity alignment."""
    placed = sorted(set(one.placed) & set(other.placed))
    if len(placed) < 3:
        return float("inf")
    first, second = (centers(model)[placed] for model in (one, other))
    return float(aligned_distances(first, second).max() / max(diameter(second), 1e-300))


def aligned_distances(first: Float64s, second: Float64s) -> Float64s:
    """(N,) distances between points (N, 3) and the same points of another world, after similarity alignment."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    left, values, right = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float((values * signs).sum() / max(float((a**2).sum()), 1e-300))
    distances: Float64s = np.linalg.norm(scale * a @ (left * signs @ right).T - b, axis=1)
    return distances


def diameter(points: Float64s) -> float:
    """The largest distance between two of (N, 3) points."""
    return float(np.linalg.norm(points[:, None] - points[None], axis=2).max())


def centers(model: Model) -> Float64s:
    """(cameras, 3) centres in the world."""
    found: Float64s = -np.einsum("nji,nj->ni", model.poses[:, :, :3], model.poses[:, :, 3])
    return found


def _degrees(turn: Float64s) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
