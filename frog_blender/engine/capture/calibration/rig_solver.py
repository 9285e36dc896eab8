"""Bundle adjustment of a small rig with numpy alone: standing cameras that saw moving bodies.

A body is a rigid board in one frame, or a single point. Cameras and lenses meet in one dense system; bodies are
eliminated from it (Schur complement). Levenberg-Marquardt with Cauchy's loss; Jacobians are analytic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float64s, Ints

FOCAL, K1, K2, CENTER_X, CENTER_Y = range(5)
"""Columns of ``Rig.lenses``: focal length in pixels, two radial coefficients, principal point in pixels."""
_POSE = 6  # a turn about the camera's or the body's own origin, then a shift
_NEAREST = 1e-6  # depth below which a point counts as behind the camera
_BEHIND = 1e3  # pixels of residual of a point behind its camera: worse than any in front of it


@dataclass(frozen=True, eq=False)
class Sightings:
    """Who saw what where, M rows.

    Attributes:
        cameras: (M,) index of the camera.
        bodies: (M,) index of the body.
        places: (M, 3) position in the body's own axes; zeros for single points.
        pixels: (M, 2) where it was seen.
        velocities: (M, 2) pixels a second by which that moves with the camera's clock; None where clocks are known.
    """

    cameras: Ints
    bodies: Ints
    places: Float64s
    pixels: Float64s
    velocities: Float64s | None = None

    def __len__(self) -> int:
        return len(self.cameras)

    def where(self, chosen: Bools) -> Sightings:
        """The chosen rows; bodies keep their numbers."""
        velocities = None if self.velocities is None else self.velocities[chosen]
        return Sightings(
            self.cameras[chosen], self.bodies[chosen], self.places[chosen], self.pixels[chosen], velocities
        )

    def delayed(self, delays: Float64s | None) -> Float64s:
        """(M, 2) pixels where each was seen once the cameras' clocks are corrected by (C,) seconds."""
        if self.velocities is None or delays is None:
            return self.pixels
        later: Float64s = self.pixels + delays[self.cameras, None] * self.velocities
        return later


@dataclass(frozen=True, eq=False)
class Rig:
    """What is solved for.

    Attributes:
        rotations, translations: (C, 3, 3) and (C, 3), world to camera; the first camera never moves.
        lenses: (L, 5), see FOCAL.
        lens_of: (C,) index of each camera's lens; cameras of one kind share one.
        body_rotations, body_positions: (B, 3, 3) and (B, 3), body to world.
        delays: (C,) seconds of each camera's film at which the sightings should have been taken, later than they were;
            None where clocks are known.
    """

    rotations: Float64s
    translations: Float64s
    lenses: Float64s
    lens_of: Ints
    body_rotations: Float64s
    body_positions: Float64s
    delays: Float64s | None = None

    @property
    def centers(self) -> Float64s:
        """(C, 3) camera centres in the world."""
        centers: Float64s = -np.einsum("cji,cj->ci", self.rotations, self.translations)
        return centers

    def residuals(self, seen: Sightings) -> Float64s:
        """(M, 2) pixels, projected minus seen; far outside the image where a point lies behind its camera."""
        return _project(self, seen).residuals


@dataclass(frozen=True)
class Options:
    """How to solve.

    Attributes:
        free: (L, 5) which lens parameters may move.
        turning: bodies turn (boards) or only shift (points).
        loss_scale: pixels of residual at which Cauchy's loss halves a sighting's weight.
        iterations: most steps that are tried.
        holding: cameras keep their poses.
        timing: the cameras' clocks may move, all but the first one's; sightings must have velocities, the rig delays.
        least_gain: part of the cost; a step that gains less ends the work.
    """

    free: Bools
    turning: bool
    loss_scale: float
    iterations: int = 60
    holding: bool = False
    timing: bool = False
    least_gain: float = 1e-7


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved rig.

    Attributes:
        rig: cameras, lenses, bodies.
        cost: sum over the sightings of Cauchy's loss, square pixels.
        lens_sigmas: (L, 5) standard deviations of the lens parameters (pixels; the focal length relative),
            from the residuals and the curvature; 0 where a parameter was held.
        delay_sigmas: (C,) the same of the clocks, seconds.
    """

    rig: Rig
    cost: float
    lens_sigmas: Float64s
    delay_sigmas: Float64s


@dataclass(frozen=True, eq=False)
class _Projection:
    residuals: Float64s  # (M, 2)
    local: Float64s  # (M, 3) in the camera's axes
    turned: Float64s  # (M, 3) the place within its body, in the world's directions
    is_behind: Bools  # (M,)


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations: cameras and lenses (n), bodies (B blocks of d)."""

    shared: Float64s  # (n, n)
    mixed: Float64s  # (B, n, d)
    own: Float64s  # (B, d, d)
    shared_slope: Float64s  # (n,)
    own_slope: Float64s  # (B, d)


def solve(rig: Rig, seen: Sightings, options: Options) -> Solution:
    """The rig that explains the sightings best, from a start near it.

    Scale and place of the world stay roughly those of the start: nothing in the sightings of points says them.
    """
    projection = _project(rig, seen)
    cost = _cost(projection, options.loss_scale)
    damping = 1e-3
    system = _normal_equations(rig, seen, projection, options)
    for _ in range(options.iterations):
        steps = _damped_steps(system, damping)
        candidate = rig if steps is None else _moved(rig, options, *steps)
        moved = _project(candidate, seen)
        moved_cost = _cost(moved, options.loss_scale)
        if steps is None or not moved_cost < cost:
            damping *= 6.0
            if damping > 1e9:
                break
            continue
        gain = 1.0 - moved_cost / max(cost, 1e-300)
        rig, projection, cost = candidate, moved, moved_cost
        damping = max(damping / 5.0, 1e-9)
        if gain < options.least_gain:
            break
        system = _normal_equations(rig, seen, projection, options)
    system = _normal_equations(rig, seen, projection, options)
    return Solution(rig, cost, *_sigmas(rig, projection, system, options))


def rotations_about(vectors: Float64s) -> Float64s:
    """(N, 3, 3) rotations about vectors (N, 3) by their lengths in radians."""
    angles = np.linalg.norm(vectors, axis=1)
    safe = np.maximum(angles, 1e-12)
    cross = _cross(vectors / safe[:, None])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    rotations: Float64s = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return rotations


def _cross(vectors: Float64s) -> Float64s:
    """(N, 3, 3) matrices that take the cross product with each vector (N, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2] = -z, y
    matrices[:, 1, 0], matrices[:, 1, 2] = z, -x
    matrices[:, 2, 0], matrices[:, 2, 1] = -y, x
    return matrices


def _project(rig: Rig, seen: Sightings) -> _Projection:
    turned = np.einsum("mij,mj->mi", rig.body_rotations[seen.bodies], seen.places)
    world = turned + rig.body_positions[seen.bodies]
    local = np.einsum("mij,mj->mi", rig.rotations[seen.cameras], world) + rig.translations[seen.cameras]
    is_behind = local[:, 2] < _NEAREST
    lens = rig.lenses[rig.lens_of[seen.cameras]]
    flat = local[:, :2] / np.where(is_behind, 1.0, local[:, 2])[:, None]
    squared = (flat**2).sum(1)
    grown = 1.0 + squared * (lens[:, K1] + squared * lens[:, K2])
    residuals = lens[:, FOCAL, None] * grown[:, None] * flat + lens[:, CENTER_X:] - seen.delayed(rig.delays)
    residuals[is_behind] = _BEHIND
    return _Projection(residuals, local, turned, is_behind)


def _cost(projection: _Projection, scale: float) -> float:
    squared = (projection.residuals**2).sum(1)
    return float(scale**2 * np.log1p(squared / scale**2).sum())


def _weights(projection: _Projection, scale: float) -> Float64s:
    """(M,) Cauchy's weights; a point behind its camera pulls nowhere."""
    weights: Float64s = 1.0 / (1.0 + (projection.residuals**2).sum(1) / scale**2)
    weights[projection.is_behind] = 0.0
    return weights


def _jacobians(rig: Rig, seen: Sightings, projection: _Projection) -> tuple[Float64s, Float64s, Float64s]:
    """Derivatives of the residuals: (M, 2, 6) by the camera's pose, (M, 2, 5) by its lens, (M, 2, 6) by the body."""
    local = projection.local
    lens = rig.lenses[rig.lens_of[seen.cameras]]
    depth = np.where(projection.is_behind, 1.0, local[:, 2])
    flat = local[:, :2] / depth[:, None]
    squared = (flat**2).sum(1)
    focal, k1, k2 = lens[:, FOCAL], lens[:, K1], lens[:, K2]
    grown = 1.0 + squared * (k1 + squared * k2)
    by_flat = focal[:, None, None] * (
        grown[:, None, None] * np.eye(2)
        + 2.0 * (k1 + 2.0 * squared * k2)[:, None, None] * flat[:, :, None] * flat[:, None, :]
    )
    flat_by_local = np.zeros((len(seen), 2, 3))
    flat_by_local[:, 0, 0] = flat_by_local[:, 1, 1] = 1.0 / depth
    flat_by_local[:, :, 2] = -flat / depth[:, None]
    by_local = by_flat @ flat_by_local
    by_camera = np.concatenate([-by_local @ _cross(local), by_local], axis=2)
    by_lens = np.zeros((len(seen), 2, 5))
    by_lens[:, :, FOCAL] = (focal * grown)[:, None] * flat  # by the focal length's logarithm
    by_lens[:, :, K1] = (focal * squared)[:, None] * flat
    by_lens[:, :, K2] = (focal * squared**2)[:, None] * flat
    by_lens[:, 0, CENTER_X] = by_lens[:, 1, CENTER_Y] = 1.0
    by_world = by_local @ rig.rotations[seen.cameras]
    by_body = np.concatenate([-by_world @ _cross(projection.turned), by_world], axis=2)
    return by_camera, by_lens, by_body


def _normal_equations(rig: Rig, seen: Sightings, projection: _Projection, options: Options) -> _System:
    by_camera, by_lens, by_body = _jacobians(rig, seen, projection)
    if not options.turning:
        by_body = by_body[:, :, 3:]
    count = _first_delay(rig, options) + (len(rig.rotations) - 1 if options.timing else 0)
    bodies, size = len(rig.body_positions), by_body.shape[2]
    shared, shared_slope = np.zeros((count, count)), np.zeros(count)
    mixed = np.zeros((bodies, count, size))
    own, own_slope = np.zeros((bodies, size, size)), np.zeros((bodies, size))
    weights = _weights(projection, options.loss_scale)
    weighted = by_body * weights[:, None, None]
    np.add.at(own, seen.bodies, np.einsum("mai,maj->mij", weighted, by_body))
    np.add.at(own_slope, seen.bodies, np.einsum("mai,ma->mi", weighted, projection.residuals))
    for camera, (columns, is_free) in enumerate(_columns(rig, options)):
        rows = np.flatnonzero(seen.cameras == camera)
        by_shared = np.concatenate([by_camera[rows], by_lens[rows][:, :, is_free]], axis=2)
        if options.timing and camera and seen.velocities is not None:
            columns = np.append(columns, _first_delay(rig, options) + camera - 1)
            by_shared = np.concatenate([by_shared, -seen.velocities[rows][:, :, None]], axis=2)
        pulled = by_shared * weights[rows, None, None]
        shared[np.ix_(columns, columns)] += np.einsum("mai,maj->ij", pulled, by_shared)
        shared_slope[columns] += np.einsum("mai,ma->i", pulled, projection.residuals[rows])
        part = np.zeros((bodies, len(columns), size))
        np.add.at(part, seen.bodies[rows], np.einsum("mai,maj->mij", pulled, by_body[rows]))
        mixed[:, columns] += part
    held = _held_columns(rig, options)
    return _System(shared[held:, held:], mixed[:, held:], own, shared_slope[held:], own_slope)


def _held_columns(rig: Rig, options: Options) -> int:
    """The first camera's pose is the world's; it comes first among the columns."""
    return _POSE * (len(rig.rotations) if options.holding else 1)


def _first_delay(rig: Rig, options: Options) -> int:
    """The first clock's column: after those of the poses and of the lenses."""
    return _POSE * len(rig.rotations) + int(options.free.sum())


def _columns(rig: Rig, options: Options) -> Iterator[tuple[Ints, Bools]]:
    """By camera: the columns of its pose and of its lens, and which of the lens's parameters those are."""
    first = _POSE * len(rig.rotations) + np.concatenate([[0], np.cumsum(options.free.sum(1))])
    for camera, lens in enumerate(rig.lens_of.tolist()):
        pose = np.arange(_POSE * camera, _POSE * (camera + 1))
        yield np.concatenate([pose, np.arange(first[lens], first[lens + 1])]), options.free[lens]


def _damped_steps(system: _System, damping: float) -> tuple[Float64s, Float64s] | None:
    """Steps of the shared parameters (n,) and of the bodies (B, d); None where the system has no solution."""
    size = system.own.shape[1]
    diagonal = np.einsum("bii->bi", system.own)
    own = system.own + np.eye(size) * (damping * diagonal + 1e-9 * (1.0 + diagonal))[:, :, None]
    shared = system.shared + np.diag(damping * system.shared.diagonal() + 1e-12 * (1.0 + system.shared.diagonal()))
    try:
        inverse = np.linalg.inv(own)
        carried = system.mixed @ inverse  # (B, n, d)
        reduced = shared - np.einsum("bnd,bmd->nm", carried, system.mixed, optimize=True)
        slope = system.shared_slope - np.einsum("bnd,bd->n", carried, system.own_slope)
        step = np.linalg.solve(reduced, -slope) if len(slope) else np.zeros(0)
    except np.linalg.LinAlgError:
        return None
    pulled = system.own_slope + np.einsum("bnd,n->bd", system.mixed, step)
    bodies = -np.einsum("bij,bj->bi", inverse, pulled)
    return (step, bodies) if np.isfinite(step).all() and np.isfinite(bodies).all() else None


def _moved(rig: Rig, options: Options, step: Float64s, bodies: Float64s) -> Rig:
    held, poses_end = _held_columns(rig, options), _POSE * len(rig.rotations)
    full = np.concatenate([np.zeros(held), step])
    poses = full[:poses_end].reshape(-1, _POSE)
    turns = rotations_about(poses[:, :3])
    lens_step = np.zeros(rig.lenses.shape)
    lenses_end = _first_delay(rig, options)
    lens_step[options.free] = full[poses_end:lenses_end]
    lenses = rig.lenses + lens_step
    lenses[:, FOCAL] = rig.lenses[:, FOCAL] * np.exp(np.clip(lens_step[:, FOCAL], -0.5, 0.5))
    delays = rig.delays
    if options.timing and delays is not None:
        delays = delays + np.concatenate([[0.0], full[lenses_end:]])
    return replace(
        rig,
        delays=delays,
        rotations=turns @ rig.rotations,
        translations=np.einsum("cij,cj->ci", turns, rig.translations) + poses[:, 3:],
        lenses=lenses,
        body_rotations=rotations_about(bodies[:, :3]) @ rig.body_rotations if options.turning else rig.body_rotations,
        body_positions=rig.body_positions + bodies[:, -3:],
    )


def _sigmas(rig: Rig, projection: _Projection, system: _System, options: Options) -> tuple[Float64s, Float64s]:
    """Standard deviations (L, 5) of the lenses' parameters and (C,) of the clocks."""
    size = system.own.shape[1]
    inverse = np.linalg.inv(system.own + np.eye(size) * 1e-9 * (1.0 + np.einsum("bii->bi", system.own))[:, :, None])
    reduced = system.shared - np.einsum("bnd,bmd->nm", system.mixed @ inverse, system.mixed, optimize=True)
    units = np.sqrt(np.maximum(reduced.diagonal(), 1e-300))
    # The world's free scale has no curvature: its direction is left out.
    covariance = np.linalg.pinv(reduced / np.outer(units, units), rcond=1e-10, hermitian=True) / np.outer(units, units)
    weights = _weights(projection, options.loss_scale)
    unknowns = len(reduced) + size * len(rig.body_positions)
    spread = (weights * (projection.residuals**2).sum(1)).sum() / max(2.0 * weights.sum() - unknowns, 1.0)
    found = np.concatenate([np.zeros(_held_columns(rig, options)), covariance.diagonal()])
    found = np.sqrt(np.maximum(found, 0.0) * spread)
    lenses_end = _first_delay(rig, options)
    sigmas = np.zeros(rig.lenses.shape)
    sigmas[options.free] = found[_POSE * len(rig.rotations) : lenses_end]
    delays = np.zeros(len(rig.rotations))
    if options.timing:
        delays[1:] = found[lenses_end:]
    return sigmas, delays
