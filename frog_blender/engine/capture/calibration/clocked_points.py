"""Clocks of standing cameras' films from points that move: COLMAP's adjustment has none.

One step of Gauss and Newton from adjusted cameras, in which poses, focal lengths and points may follow the clocks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Float64s
from .colmap import SOFT, Adjusted
from .model import Model
from .tracks import Tracks, summed

_POSE = 6  # a turn about the camera's own origin, then a shift


def clock_steps(
    adjusted: Adjusted, tracks: Tracks, velocities: Float64s, groups: Sequence[int]
) -> tuple[Float64s, Float64s]:
    """By how many seconds each film should be read later, (C,), the first one 0, and their standard deviations.

    Args:
        adjusted: without lens distortion. Observations of points that it does not locate are left out.
        velocities: (N, 2) pixels a second by which observations move with their camera's clock.
        groups: cameras of one number, counted from 0, share their focal length.
    """
    known = np.isfinite(adjusted.points).all(axis=1)
    moving, used = velocities[known[tracks.points]], tracks.chosen(known[tracks.points])
    off, by_shared, by_point = _jacobians(adjusted.model, adjusted.points[known], used, moving, groups)
    squares = (off**2).sum(axis=1)
    weights = 1.0 / (1.0 + squares / (SOFT * adjusted.model.limits.min()) ** 2)  # Cauchy's
    weights[~by_shared.any(axis=(1, 2))] = 0.0  # behind its camera
    heavy_shared, heavy_point = by_shared * weights[:, None, None], by_point * weights[:, None, None]
    # The points are eliminated (Schur complement).
    own = summed(np.einsum("nai,naj->nij", heavy_point, by_point), used)
    inverse = np.linalg.inv(own + 1e-9 * np.eye(3) * (1.0 + np.trace(own, axis1=1, axis2=2))[:, None, None])
    mixed = summed(np.einsum("nai,naj->nij", by_shared, heavy_point), used) @ inverse
    slope = np.einsum("nai,na->i", heavy_shared, off)
    slope -= np.einsum("pij,pj->i", mixed, summed(np.einsum("nai,na->ni", heavy_point, off), used))
    curvature = np.einsum("nai,naj->ij", heavy_shared, by_shared, optimize=True)
    curvature -= np.einsum("pij,pjk,plk->il", mixed, own, mixed, optimize=True)
    # The world's free scale, and what is held, have no curvature: their directions are left out.
    diagonal = curvature.diagonal()
    scaled = np.where(diagonal > 1e-9 * diagonal.max(), 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0)
    covariance = np.outer(scaled, scaled) * np.linalg.pinv(
        curvature * np.outer(scaled, scaled), rcond=1e-10, hermitian=True
    )
    unknowns = int((scaled > 0).sum()) + 3 * len(own)
    spread = (weights * squares).sum() / max(2.0 * weights.sum() - unknowns, 1.0)
    clocks = slice(len(slope) - len(groups), None)
    sigmas = np.sqrt(np.maximum(covariance.diagonal(), 0.0) * spread)
    return -(covariance @ slope)[clocks], sigmas[clocks]


def _jacobians(
    model: Model, points: Float64s, tracks: Tracks, velocities: Float64s, groups: Sequence[int]
) -> tuple[Float64s, Float64s, Float64s]:
    """(N, 2) pixels from where points were seen to where they should be, and how these change with what cameras share
    (N, 2, n) and with the points (N, 2, 3); zeros for a point behind its camera.

    What cameras share is every camera's pose, every group's focal length (its logarithm), every camera's clock.
    """
    count, rows = len(groups), np.arange(len(tracks.points))
    pose = model.poses[tracks.cameras]
    local = np.einsum("nij,nj->ni", pose[:, :, :3], points[tracks.points]) + pose[:, :, 3]
    is_before = local[:, 2] > 0
    depth = np.where(is_before, local[:, 2], 1.0)
    flat = local[:, :2] / depth[:, None]
    lenses = np.array([[lens.focal, lens.width / 2, lens.height / 2] for lens in model.lenses])[tracks.cameras]
    focal = lenses[:, 0]
    off = focal[:, None] * flat + lenses[:, 1:] - tracks.pixels
    by_local = np.zeros((len(rows), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = focal / depth
    by_local[:, :, 2] = -focal[:, None] * flat / depth[:, None]
    by_shared = np.zeros((len(rows), 2, (_POSE + 1) * count + 1 + max(groups)))
    for axis in range(3):
        turned = np.cross(np.eye(3)[axis], local)
        by_shared[rows, :, _POSE * tracks.cameras + axis] = np.einsum("nai,ni->na", by_local, turned)
        by_shared[rows, :, _POSE * tracks.cameras + 3 + axis] = by_local[:, :, axis]
    by_shared[rows, :, _POSE * count + np.array(groups)[tracks.cameras]] = focal[:, None] * flat
    by_shared[rows, :, by_shared.shape[2] - count + tracks.cameras] = -velocities
    by_shared[:, :, [*range(_POSE), by_shared.shape[2] - count]] = 0.0  # the first camera's pose and clock are held
    is_before = is_before[:, None]
    return off * is_before, by_shared * is_before[..., None], by_local @ pose[:, :, :3] * is_before[..., None]
