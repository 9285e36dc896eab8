"""Where up is in a scene, and where its floor: from its cameras, then from its Gaussians.

Up comes from how people hold cameras: level, that is, with their images' lines horizontal. The direction most nearly
perpendicular to all of those is up ("vertical" in nerfstudio, nerfstudio/cameras/camera_utils.py); cameras that all
look the same way leave their pitch open, and then the mean of their images' own up is taken.

The floor is the plane with the most Gaussians in it that is nearly perpendicular to up and has nearly nothing beneath:
random samples (Fischler and Bolles, RANSAC, 1981) with a fixed seed, then a least-squares fit to what lies in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..errors import FrogError
from .player import ScenePlayer

_SAMPLES = 600  # planes that are tried
_DRAWN = 8_000  # Gaussians, at most, that vote
_THICKNESS = 0.015  # of the scene's size: how far from the plane its Gaussians may lie
_LEAST_SHARE = 0.04  # of all Gaussians' weight that a floor must hold
_TILT_KNOWN, _TILT_UNKNOWN = 15.0, 40.0  # degrees between up and a floor: cameras around the scene, side by side
_BENEATH = 3.0  # what a Gaussian under the floor takes from it, in Gaussians in it: tables have much beneath
_SPREAD = 0.04  # the cameras' lines span a plane when their second moment is above this share of the first
_LEVEL = 0.1  # sine of the roll of a camera that was meant to be level
_ROLLED = 0.2  # share of cameras that may not be: two level ones agree on any direction
_MOVES = 0.01  # of the scene's size: what goes further is no floor
_LEAST_OPACITY = 0.3


@dataclass(frozen=True)
class Floor:
    """A plane in the scene's own coordinates.

    Attributes:
        up: (3,) unit vector, the plane's normal.
        height: of the plane along ``up``, world units.
        found: True if Gaussians lie in it; else ``up`` is the cameras' and ``height`` that of the lowest Gaussians.
        share: of the Gaussians' weight that lies in it.
        tilt: degrees between ``up`` and what the cameras say.
    """

    up: Array
    height: float
    found: bool
    share: float
    tilt: float


def static_points(scene: ScenePlayer) -> tuple[Array, Array]:
    """Points (N, 3) and weights (N,) of the opaque Gaussians that stay where they are; all if that leaves none.

    A weight is opacity times size, so that a bare floor of a few large Gaussians counts as what it covers.
    """
    start, middle, end = (scene.at(time) for time in (0.0, 0.5, 1.0))
    extent = _size(middle.means)
    moved = np.max([np.linalg.norm(other.means - middle.means, axis=1) for other in (start, end)], axis=0)
    kept = (moved < _MOVES * extent) & (middle.opacities > _LEAST_OPACITY)
    if not kept.any():
        kept[:] = True
    area = np.sort(middle.scales[kept].astype(np.float64), axis=1)[:, 1:].prod(1)
    area = np.minimum(area, np.quantile(area, 0.9))  # or the sky decides
    return middle.means[kept].astype(np.float64), middle.opacities[kept] * area


def camera_up(cameras: Sequence[Camera]) -> tuple[Array, bool]:
    """(3,) unit up of level cameras, and whether it is certain (False: their pitch is still in it).

    FrogError without a camera.
    """
    if not cameras:
        raise FrogError("The scene has no cameras that could say where up is.")
    up = _unit(_robust_mean(np.array([-camera.rotation[1] for camera in cameras])))
    lines = np.array([camera.rotation[0] for camera in cameras])
    weights = np.ones(len(lines))
    vertical, spread = up, False
    for _ in range(10):  # cameras that are not level lose their say, but never all of it
        moments, axes = np.linalg.eigh((lines * weights[:, None]).T @ lines)
        vertical, spread = axes[:, 0], bool(moments[1] > _SPREAD * moments[2])
        slopes = np.abs(lines @ vertical)
        weights = np.minimum(1.0, _LEVEL / np.maximum(slopes, 1e-9))
    if not spread or abs(vertical @ up) < 0.5 or np.mean(slopes > _LEVEL) > _ROLLED:
        return up, False
    return vertical * np.sign(vertical @ up), True


def find_floor(points: Array, weights: Array, up: Array, *, certain: bool = True, seed: int = 0) -> Floor:
    """The floor among points.

    Args:
        points: (N, 3) on resting, opaque surfaces, world units.
        weights: (N,) how much each counts, positive.
        up: (3,) where up is, about.
        certain: ``up`` is known to a few degrees; otherwise the floor is looked for at twice the tilt and more.
        seed: of the random samples: the same points give the same floor.
    """
    up = _unit(np.asarray(up, np.float64))
    points, weights = _seen(np.asarray(points, np.float64), np.asarray(weights, np.float64), seed)
    size = _size(points)
    none = Floor(up, min_height(points, up), False, 0.0, 0.0)
    if len(points) < 10 or size == 0.0:
        return none
    thickness = _THICKNESS * size
    steepest = np.cos(np.radians(_TILT_KNOWN if certain else _TILT_UNKNOWN))
    planes = list(zip(*_hypotheses(points, weights, up, steepest, seed), strict=True))
    scores = [_score(points @ normal - height, weights, thickness) for normal, height in planes]
    best = int(np.argmax(scores))
    if not scores[best] > 0.0:
        return none
    normal, height = _refined(points, weights, *planes[best], thickness)
    share = float(weights[np.abs(points @ normal - height) < thickness].sum() / weights.sum())
    if normal @ up < steepest or share < _LEAST_SHARE:
        return none
    return Floor(normal, height, True, share, float(np.degrees(np.arccos(min(float(normal @ up), 1.0)))))


def placement(floor: Floor, points: Array, cameras: Sequence[Camera]) -> Array:
    """(4, 4) rigid matrix from the scene to a world with the floor at z = 0 and z up.

    The middle of the points (N, 3) around it stands above the origin, and the cameras look along +y on the whole:
    Blender's view from the front is theirs.
    """
    forward = np.array([camera.forward for camera in cameras]) if cameras else np.eye(3)[1:2]
    ahead = _level(forward.mean(axis=0), floor.up)
    for direction in (*forward, np.eye(3)[0], np.eye(3)[1]):  # cameras all around look nowhere on the whole
        if np.linalg.norm(ahead) > 0.2:
            break
        ahead = _level(direction, floor.up)
    ahead = _unit(ahead)
    rotation = np.stack([np.cross(ahead, floor.up), ahead, floor.up])
    near, _ = _seen(points, np.ones(len(points)), 0)
    middle = np.median(near @ rotation[:2].T, axis=0)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, (-middle[0], -middle[1], -floor.height)
    return matrix


def min_height(points: Array, up: Array) -> float:
    """Height along ``up`` at which points (N, 3) begin, up to a few below it."""
    return float(np.quantile(points @ up, 0.02))


def _hypotheses(points: Array, weights: Array, up: Array, steepest: float, seed: int) -> tuple[Array, Array]:
    """Planes (M, 3), (M,) through three points each that are level enough, and level ones through one point."""
    random = np.random.default_rng(seed)
    triples = points[random.choice(len(points), (_SAMPLES * 4, 3), p=weights / weights.sum())]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(lengths, 1e-300)[:, None]
    normals *= np.sign(normals @ up)[:, None]
    usable = (normals @ up > steepest) & (lengths > 1e-12)
    normals, triples = normals[usable][:_SAMPLES], triples[usable][:_SAMPLES, 0]
    levels = points[random.choice(len(points), 200, p=weights / weights.sum())]
    normals = np.concatenate([normals, np.tile(up, (len(levels), 1))])
    return normals, np.einsum("ij,ij->i", normals, np.concatenate([triples, levels]))


def _score(distances: Array, weights: Array, thickness: float) -> float:
    """What lies in a plane, less what lies beneath it."""
    inside = weights[np.abs(distances) < thickness].sum()
    return float(inside - _BENEATH * weights[distances < -2 * thickness].sum())


def _refined(points: Array, weights: Array, normal: Array, height: float, thickness: float) -> tuple[Array, float]:
    """The least-squares plane of what lies in a plane, found anew until it stays."""
    for _ in range(8):
        inside = np.abs(points @ normal - height) < thickness
        share = weights[inside]
        centre = share @ points[inside] / share.sum()
        local = points[inside] - centre
        moments, axes = np.linalg.eigh((local * share[:, None]).T @ local)
        if moments[1] < 1e-3 * moments[2]:  # a line says nothing about the tilt across it
            break
        turned = axes[:, 0] * np.sign(axes[:, 0] @ normal)
        settled = turned @ normal > 1 - 1e-10
        normal, height = turned, float(turned @ centre)
        if settled:
            break
    return normal, height


def _seen(points: Array, weights: Array, seed: int) -> tuple[Array, Array]:
    """Finite points around the middle of the scene: backgrounds far away say nothing of its floor."""
    usable = np.isfinite(points).all(axis=1) & np.isfinite(weights) & (weights > 0)
    points, weights = points[usable], weights[usable]
    if not len(points):
        raise FrogError("The scene has no Gaussian at rest that could show where its floor is.")
    distances = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    near = distances <= 2.0 * np.quantile(distances, 0.8)
    points, weights = points[near], weights[near]
    if len(points) > _DRAWN:
        drawn = np.random.default_rng(seed).choice(len(points), _DRAWN, replace=False)
        points, weights = points[drawn], weights[drawn]
    return points, weights


def _size(points: Array) -> float:
    """How large a cloud is, without its outliers: the longest side of what holds its middle."""
    return float((np.quantile(points, 0.9, axis=0) - np.quantile(points, 0.1, axis=0)).max()) if len(points) else 0.0


def _robust_mean(vectors: Array) -> Array:
    """The mean of unit vectors (N, 3) without those that point elsewhere, by more than 60 degrees.

    A median would follow the larger part of a few cameras around a scene; their pitches cancel in the mean alone.
    """
    mean = vectors.mean(axis=0)
    for _ in range(3):
        kept = vectors @ mean > 0.5 * np.linalg.norm(mean)
        if not kept.any():
            break
        mean = vectors[kept].mean(axis=0)
    return np.asarray(mean)


def _level(vector: Array, up: Array) -> Array:
    return vector - (vector @ up) * up


def _unit(vector: Array) -> Array:
    length = np.linalg.norm(vector)
    if not length > 1e-9:
        raise FrogError("The cameras' images have no up in common, so the scene's floor cannot be looked for.")
    return np.asarray(vector / length)
