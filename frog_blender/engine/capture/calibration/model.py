"""What structure from motion estimates: a lens of each camera, a pose of each image, and a world to put them in.

A lens has one focal length, the principal point in the middle, and at most k1 and k2. More parameters are never
supported by such data: eight-parameter models and free principal points were worse in every case that was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Float64s
from ..camera import Camera
from ..readers.geometry import intrinsics

_INVERSIONS = 12
_TOLERANCE = 0.0025  # of the width; COLMAP's 4 pixels are for photographs of 12 megapixels
_DISTANCE = 3.0  # world units from the origin to the cameras, as in a room measured in metres
_LEVEL = 0.3  # of the sideways axes' spread, from which they tell what is level
_AGREES = 0.8  # cosine between two guesses of up


@dataclass(frozen=True)
class Lens:
    """One camera's size in pixels, focal length in pixels, and radial distortion as of OpenCV's k1 and k2.

    ``tolerance`` is the part of the width beyond which an observation is false.
    """

    width: int
    height: int
    focal: float
    k1: float = 0.0
    k2: float = 0.0
    tolerance: float = _TOLERANCE

    @property
    def limit(self) -> float:
        """Pixels beyond which an observation is false."""
        return max(1.0, self.tolerance * self.width)

    def camera(self, name: str, pose: Float64s) -> Camera:
        """The camera of a pose (3, 4), world to camera; without its distortion."""
        return Camera(
            name,
            self.width,
            self.height,
            intrinsics(self.focal, self.focal, self.width / 2, self.height / 2),
            np.vstack([pose, [[0.0, 0.0, 0.0, 1.0]]]),
        )

    def pixels(self, local: Float64s) -> Float64s:
        """(N, 2) pixels of points (N, 3) in the camera's axes, which lie before it."""
        plane = local[:, :2] / local[:, 2:]
        return self.focal * plane * self._factor(plane) + self._middle

    def rays(self, pixels: Float64s) -> Float64s:
        """(N, 2) positions in the plane at distance 1, of pixels (N, 2)."""
        distorted = (pixels - self._middle) / self.focal
        if not (self.k1 or self.k2):
            return distorted
        plane = distorted
        for _ in range(_INVERSIONS):
            plane = distorted / np.maximum(self._factor(plane), 0.1)
        return plane

    @property
    def _middle(self) -> Float64s:
        return np.array([self.width / 2, self.height / 2])

    def _factor(self, plane: Float64s) -> Float64s:
        square = np.sum(plane**2, axis=1, keepdims=True)
        factor: Float64s = 1 + self.k1 * square + self.k2 * square**2
        return factor


@dataclass(frozen=True, eq=False)
class Model:
    """Poses and lenses of cameras.

    Attributes:
        poses: (cameras, 3, 4) world to camera; NaN for a camera that has none.
        lenses: one for each camera.
    """

    poses: Float64s
    lenses: tuple[Lens, ...]

    @property
    def limits(self) -> Float64s:
        """(cameras,) pixels beyond which an observation is false."""
        return np.array([lens.limit for lens in self.lenses])

    @property
    def placed(self) -> list[int]:
        """The cameras that have a pose."""
        indices: list[int] = np.flatnonzero(np.isfinite(self.poses).all(axis=(1, 2))).tolist()
        return indices


def centers(model: Model) -> Float64s:
    """(images, 3) centres in the world."""
    positions: Float64s = -np.einsum("nji,nj->ni", model.poses[:, :, :3], model.poses[:, :, 3])
    return positions


def disagreement(one: Model, other: Model, judged: int | None = None) -> float:
    """How far two models put an image apart at worst after similarity alignment, over the images' diameter.

    Args:
        judged: only the first so many images are judged, over their diameter; of fewer than two, over that of all.
    """
    placed = np.array(sorted(set(one.placed) & set(other.placed)), dtype=np.int64)
    if len(placed) < 3:
        return float("inf")
    first, second = (centers(model)[placed] for model in (one, other))
    is_judged = placed < (len(one.poses) if judged is None else judged)
    if not is_judged.any():
        return float("inf")
    places = second[is_judged] if is_judged.sum() > 1 else second
    size = float(np.linalg.norm(places[:, None] - places, axis=2).max())
    return float(_aligned_distances(first, second)[is_judged].max() / max(size, 1e-300))


def _aligned_distances(first: Float64s, second: Float64s) -> Float64s:
    """(N,) distances between points (N, 3) and the same points of another world, after similarity alignment."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    left, values, right = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float((values * signs).sum() / max(float((a**2).sum()), 1e-300))
    distances: Float64s = np.linalg.norm(scale * a @ (left * signs @ right).T - b, axis=1)
    return distances


def oriented(model: Model, points: Float64s, *, keep_scale: bool = False) -> tuple[Model, Float64s]:
    """The model and points (N, 3) in a world with z up, y ahead, and the origin where the cameras look.

    Up is what the cameras' sideways axes have in common: people hold cameras level even where they look down. Where all
    look one way, it is the mean of the cameras' own up axes.
    """
    rotations = model.poses[model.placed][:, :, :3]
    basis = _basis(rotations)
    origin = _looked_at(model, points)
    distance = max(float(np.median(np.linalg.norm(centers(model)[model.placed] - origin, axis=1))), 1e-12)
    scale = 1.0 if keep_scale else _DISTANCE / distance
    poses = model.poses.copy()
    poses[:, :, 3] = scale * (model.poses[:, :, :3] @ origin + model.poses[:, :, 3])
    poses[:, :, :3] = model.poses[:, :, :3] @ basis.T
    return Model(poses, model.lenses), scale * (points - origin) @ basis.T


def _basis(rotations: Float64s) -> Float64s:
    """(3, 3) the world's axes, a row each, in the model's coordinates."""
    up = -rotations[:, 1].mean(axis=0)
    _, spread, axes = np.linalg.svd(rotations[:, 0])
    up /= max(float(np.linalg.norm(up)), 1e-12)
    if len(rotations) > 2 and spread[1] > _LEVEL * spread[0] and abs(axes[2] @ up) > _AGREES:
        up = axes[2] * np.sign(axes[2] @ up)
    ahead = rotations[:, 2].mean(axis=0)
    ahead = ahead - (ahead @ up) * up
    if np.linalg.norm(ahead) < 0.1:  # the cameras look at each other, or down
        first = rotations[0, 2] - (rotations[0, 2] @ up) * up
        ahead = first if np.linalg.norm(first) > 0.1 else np.cross(up, rotations[0, 0])
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(ahead, up), ahead, up])


def _looked_at(model: Model, points: Float64s) -> Float64s:
    """(3,) the middle of the points that were found, else of the cameras."""
    finite = points[np.isfinite(points).all(axis=1)]
    middle: Float64s = np.median(finite if len(finite) else centers(model)[model.placed], axis=0)
    return middle
