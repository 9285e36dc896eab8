"""Standing cameras and their films' clocks from points that move: a bundle adjustment whose unknowns include clocks.

COLMAP has no clocks. Levenberg-Marquardt with Cauchy's loss and analytic Jacobians, for the few cameras and thousands
of points that a person's joints are; the points are eliminated (Schur complement).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...arrays import Float64s
from .colmap import Adjusted
from .model import Model
from .tracks import Tracks, residuals, summed

_ITERATIONS = 60
_LEAST_GAIN = 1e-7  # of the cost; a step that gains less ends the work
_MOST_DAMPING = 1e9
_POSE = 6  # a turn about the camera's own origin, then a shift


@dataclass(frozen=True, eq=False)
class Clocked:
    """Cameras without lens distortion, points, and (C,) seconds by which each film should be read later than it was."""

    model: Model
    points: Float64s
    delays: Float64s

    def offsets(self, tracks: Tracks, velocities: Float64s) -> Float64s:
        """(N, 2) pixels from where points were seen, once clocks are corrected, to where they should be."""
        pose = self.model.poses[tracks.cameras]
        local = np.einsum("nij,nj->ni", pose[:, :, :3], self.points[tracks.points]) + pose[:, :, 3]
        lenses = np.array([[lens.focal, lens.width / 2, lens.height / 2] for lens in self.model.lenses])[tracks.cameras]
        depth = np.where(local[:, 2:] > 0, local[:, 2:], np.nan)  # a point behind its camera pulls nowhere
        seen = tracks.pixels + self.delays[tracks.cameras, None] * velocities
        return np.asarray(lenses[:, :1] * local[:, :2] / depth + lenses[:, 1:] - seen)


class _System(NamedTuple):
    """Normal equations of what cameras share (n) and of the points (P blocks of 3)."""

    shared: Float64s  # (n, n)
    mixed: Float64s  # (P, n, 3)
    own: Float64s  # (P, 3, 3)
    slope: Float64s  # (n,)
    own_slope: Float64s  # (P, 3)


def adjust_clocks(
    adjusted: Adjusted, tracks: Tracks, velocities: Float64s, groups: Sequence[int], loss: float
) -> tuple[Adjusted, Float64s, Float64s]:
    """The model with clocks, these (C,) in seconds, the first one's being 0, and their standard deviations.

    Args:
        adjusted: where to start. Observations of points that it does not locate are left out.
        velocities: (N, 2) pixels a second by which observations move with their camera's clock.
        groups: cameras of one number, counted from 0, share their focal length.
        loss: Cauchy's scale in pixels.
    """
    used = tracks.chosen(np.isfinite(adjusted.points).all(axis=1)[tracks.points])
    known = np.isfinite(adjusted.points).all(axis=1)
    moving = velocities[known[tracks.points]]
    start = Clocked(adjusted.model, adjusted.points[known], np.zeros(len(groups)))
    found, damping = start, 1e-3
    off = found.offsets(used, moving)
    system = _system(found, used, moving, groups, off, loss)
    for _ in range(_ITERATIONS):
        step = _step(system, damping)
        candidate = found if step is None else _moved(found, groups, *step)
        candidate_off = candidate.offsets(used, moving)
        gain = 1.0 - _cost(candidate_off, loss) / max(_cost(off, loss), 1e-300)
        if step is None or not gain > 0:
            damping *= 6.0
            if damping > _MOST_DAMPING:
                break
            continue
        found, off, damping = candidate, candidate_off, max(damping / 5.0, 1e-9)
        system = _system(found, used, moving, groups, off, loss)
        if gain < _LEAST_GAIN:
            break
    sigmas = _sigmas(system, off, loss)
    first = _POSE * len(groups)
    focals = sigmas[first : first + 1 + max(groups)]
    points = np.full_like(adjusted.points, np.nan)
    points[known] = found.points
    shifted = replace(tracks, pixels=tracks.pixels + found.delays[tracks.cameras, None] * velocities)
    distances = residuals(shifted, points, found.model.poses, found.model.lenses)
    return Adjusted(found.model, points, distances, focals[list(groups)]), found.delays, sigmas[-len(groups) :]


def _cost(off: Float64s, loss: float) -> float:
    return float(np.log1p(np.nan_to_num((off**2).sum(axis=1), nan=1e6) / loss**2).sum())


def _weights(off: Float64s, loss: float) -> Float64s:
    weights: Float64s = 1.0 / (1.0 + np.nan_to_num((off**2).sum(axis=1), nan=np.inf) / loss**2)
    return weights


def _system(
    found: Clocked, tracks: Tracks, velocities: Float64s, groups: Sequence[int], off: Float64s, loss: float
) -> _System:
    """Columns: every camera's pose, every group's focal length (its logarithm), every camera's clock."""
    count, rows = len(groups), np.arange(len(tracks.points))
    pose = found.model.poses[tracks.cameras]
    local = np.einsum("nij,nj->ni", pose[:, :, :3], found.points[tracks.points]) + pose[:, :, 3]
    depth = np.where(local[:, 2] > 0, local[:, 2], np.inf)
    flat = local[:, :2] / depth[:, None]
    focal = np.array([lens.focal for lens in found.model.lenses])[tracks.cameras]
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
    by_point = by_local @ pose[:, :, :3]
    off, weighted = np.nan_to_num(off), by_point * _weights(off, loss)[:, None, None]
    weighted_shared = by_shared * _weights(off, loss)[:, None, None]
    return _System(
        np.einsum("nai,naj->ij", weighted_shared, by_shared, optimize=True),
        summed(np.einsum("nai,naj->nij", by_shared, weighted), tracks),
        summed(np.einsum("nai,naj->nij", weighted, by_point), tracks),
        np.einsum("nai,na->i", weighted_shared, off),
        summed(np.einsum("nai,na->ni", weighted, off), tracks),
    )


def _step(system: _System, damping: float) -> tuple[Float64s, Float64s] | None:
    """Steps of what cameras share (n,) and of the points (P, 3); None where the system has no solution."""
    diagonal = np.einsum("pii->pi", system.own)
    own = system.own + np.eye(3) * (damping * diagonal + 1e-9 * (1.0 + diagonal))[:, :, None]
    shared = system.shared + np.diag(damping * system.shared.diagonal() + 1e-12 * (1.0 + system.shared.diagonal()))
    try:
        inverse = np.linalg.inv(own)
        through = system.mixed @ inverse
        reduced = shared - np.einsum("pnd,pmd->nm", through, system.mixed, optimize=True)
        step = np.linalg.solve(reduced, np.einsum("pnd,pd->n", through, system.own_slope) - system.slope)
    except np.linalg.LinAlgError:
        return None
    points = -np.einsum("pij,pj->pi", inverse, system.own_slope + np.einsum("pnd,n->pd", system.mixed, step))
    return (step, points) if np.isfinite(step).all() and np.isfinite(points).all() else None


def _moved(found: Clocked, groups: Sequence[int], step: Float64s, points: Float64s) -> Clocked:
    count = len(groups)
    poses = found.model.poses.copy()
    for camera, (turn, shift) in enumerate(step[: _POSE * count].reshape(count, 2, 3)):
        rotation = _rotation(turn)
        poses[camera] = rotation @ poses[camera]
        poses[camera, :, 3] += shift
    growth = np.exp(np.clip(step[_POSE * count : -count], -0.5, 0.5))[list(groups)].tolist()
    lenses = (replace(lens, focal=lens.focal * by) for lens, by in zip(found.model.lenses, growth, strict=True))
    return Clocked(Model(poses, tuple(lenses)), found.points + points, found.delays + step[-count:])


def _rotation(vector: Float64s) -> Float64s:
    """(3, 3) about a vector (3,) by its length in radians."""
    angle = max(float(np.linalg.norm(vector)), 1e-12)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Float64s = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return rotation


def _sigmas(system: _System, off: Float64s, loss: float) -> Float64s:
    """(n,) standard deviations from the residuals and the curvature; 0 for what was held."""
    own = system.own + np.eye(3) * 1e-9 * (1.0 + np.einsum("pii->pi", system.own))[:, :, None]
    through = system.mixed @ np.linalg.inv(own)
    reduced = system.shared - np.einsum("pnd,pmd->nm", through, system.mixed, optimize=True)
    units = np.sqrt(np.maximum(reduced.diagonal(), 1e-300))
    # The world's free scale, and what was held, have no curvature: their directions are left out.
    scaled = np.where(units > 1e-100, 1.0 / units, 0.0)
    covariance = np.linalg.pinv(reduced * np.outer(scaled, scaled), rcond=1e-10, hermitian=True)
    weights = _weights(off, loss)
    unknowns = int((scaled > 0).sum()) + 3 * len(system.own)
    spread = (weights * np.nan_to_num((off**2).sum(axis=1))).sum() / max(2.0 * weights.sum() - unknowns, 1.0)
    found: Float64s = scaled * np.sqrt(np.maximum(covariance.diagonal(), 0.0) * spread)
    return found
