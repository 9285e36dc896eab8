"""What rigs would see of points on surfaces, without images: features and their matches, false ones among them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from frog_blender.engine.arrays import Array, Float64s
from frog_blender.engine.capture.calibration.checks import calibration_of, refusal, warnings
from frog_blender.engine.capture.calibration.colmap import verified
from frog_blender.engine.capture.calibration.model import Lens, Model
from frog_blender.engine.capture.calibration.structure import Images, Solution, solve
from frog_blender.engine.capture.camera import Camera

from .rigs import pixels_of

_NOISE = 0.3  # pixels
_FALSE = 0.15  # of the matches of a pair
_FURTHEST = 40.0  # degrees between two views of a feature that are still alike


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Points (N, 3) on surfaces, and the normals (N, 3) of those."""

    points: Float64s
    normals: Float64s


def room(count: int, seed: int, half: float = 3.0) -> Surfaces:
    """Four walls and a floor, with crates in the middle."""
    random = np.random.default_rng(seed)
    parts = [_rectangle(random, count // 5, (-half, -half, 0), (2 * half, 0, 0), (0, 2 * half, 0))]
    for a, b in [((-1, 1), (1, 0)), ((1, 1), (0, -1)), ((1, -1), (-1, 0)), ((-1, -1), (0, 1))]:
        corner = (half * a[0], half * a[1], 0)
        parts.append(_rectangle(random, count // 8, corner, (2 * half * b[0], 2 * half * b[1], 0), (0, 0, 2.8)))
    for x, y in [(-1.2, 0.8), (0.9, 1.1), (0.2, -0.4), (-0.7, -0.9)]:
        edge = random.uniform(0.4, 0.9)
        for across, up in [((edge, 0, 0), (0, 0, 1.0)), ((0, edge, 0), (0, 0, 1.0)), ((edge, 0, 0), (0, edge, 0))]:
            parts.append(_rectangle(random, count // 40, (x, y, 0.0 if up[2] else 1.0), across, up))
    return Surfaces(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def wall(count: int, seed: int) -> Surfaces:
    """One flat wall."""
    return Surfaces(*_rectangle(np.random.default_rng(seed), count, (-6, 2, -3), (12, 0, 0), (0, 0, 8)))


def _rectangle(
    random: np.random.Generator, count: int, corner: Sequence[float], across: Sequence[float], up: Sequence[float]
) -> tuple[Float64s, Float64s]:
    shares = random.uniform(0, 1, (count, 2))
    normal = np.cross(across, up) / np.linalg.norm(np.cross(across, up))
    points = np.array(corner) + shares[:, :1] * np.array(across) + shares[:, 1:] * np.array(up)
    return points, np.broadcast_to(normal, points.shape).astype(float)


@dataclass(frozen=True, eq=False)
class Solved:
    """What comes of the sightings of cameras by name."""

    solution: Solution
    refusal: str | None
    warnings: list[str]

    @property
    def model(self) -> Model:
        """All cameras have a place in it."""
        return self.solution.adjusted.model


def solved(
    cameras: Sequence[Camera],
    surfaces: Surfaces,
    seed: int = 0,
    *,
    k1: float = 0.0,
    false: float = _FALSE,
    groups: Sequence[int] | None = None,
) -> Solved:
    """What structure from motion makes of them."""
    random = np.random.default_rng(seed)
    seen = [_seen(random, camera, surfaces, k1) for camera in cameras]
    lenses = tuple(Lens(camera.width, camera.height, 1.2 * camera.width) for camera in cameras)
    matches, checked = {}, {}
    for one, other in combinations(range(len(cameras)), 2):
        found = _matches(random, seen[one], seen[other], false)
        matches[one, other] = found
        checked[one, other] = verified(lenses[one], seen[one][0], lenses[other], seen[other][0], found)
    images = Images(lenses, tuple(groups or [0] * len(cameras)), tuple(pixels for pixels, _, _ in seen), len(cameras))
    solution = solve(images, matches, checked, lambda *_: None)
    names = [camera.name for camera in cameras]
    if (why := refusal(solution, images, matches, names)) is not None:
        return Solved(solution, why, [])
    return Solved(solution, None, warnings(solution, images, calibration_of(names, solution.adjusted).cameras))


Seen = tuple[Float64s, Array, Float64s]  # pixels, indices of the points, unit vectors towards the camera


def _seen(random: np.random.Generator, camera: Camera, surfaces: Surfaces, k1: float) -> Seen:
    pixels = pixels_of(camera, surfaces.points, k1)
    towards = camera.center - surfaces.points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    facing = np.abs(np.sum(towards * surfaces.normals, axis=1)) > 0.25  # cosine: flatter ones look like nothing
    chosen = np.flatnonzero(np.isfinite(pixels).all(axis=1) & facing & (random.random(len(pixels)) < 0.8))
    return pixels[chosen] + random.normal(0, _NOISE, (len(chosen), 2)), chosen, towards[chosen]


def _matches(random: np.random.Generator, one: Seen, other: Seen, false: float) -> Array:
    _, first, second = np.intersect1d(one[1], other[1], return_indices=True)
    angles = np.degrees(np.arccos(np.clip(np.sum(one[2][first] * other[2][second], axis=1), -1, 1)))
    alike = random.random(len(first)) < np.clip(1.2 - angles / _FURTHEST, 0, 0.9)
    true = np.stack([first[alike], second[alike]], axis=1)
    count = int(false * len(true)) + 10
    wrong = np.stack([random.integers(0, max(len(seen[1]), 1), count) for seen in (one, other)], axis=1)
    both = np.concatenate([true, wrong])
    for column in (0, 1):  # a feature matches once
        both = both[np.sort(np.unique(both[:, column], return_index=True)[1])]
    return both


def as_cameras(solved: Solved) -> list[Camera]:
    """The cameras of a solution that places all."""
    assert np.isfinite(solved.model.poses).all()
    placed = zip(solved.model.lenses, solved.model.poses, strict=True)
    return [lens.camera(f"cam{index}", pose) for index, (lens, pose) in enumerate(placed)]
