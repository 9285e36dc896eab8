"""What calibration estimates: a lens of each camera, a pose of each image, points, a world to put them in; its result.

A lens has one focal length, the principal point in the middle, and at most k1 and k2. More parameters are never
supported by such data: eight-parameter models and free principal points were worse in every case that was measured.

Points are those that several cameras see: matches joined across pairs of cameras, triangulated, and judged by their
residuals. One measure serves every comparison of solutions: the truncated squared reprojection residual of the same
observations. A low mean residual says nothing, since bad solutions lose the observations that would raise it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ...graphs import components
from ..camera import Camera
from ..readers.geometry import intrinsics
from ..synchronization.motion import Cameras

_INVERSIONS = 12
_TOLERANCE = 0.0025  # of the width; COLMAP's 4 pixels are for photographs of 12 megapixels
_DISTANCE = 3.0  # world units from the origin to the cameras, as in a room measured in metres
_LEVEL = 0.3  # of the sideways axes' spread, from which they tell what is level
_AGREES = 0.8  # cosine between two guesses of up

Pairs = Mapping[tuple[int, int], Ints]
"""Indices of matching features (M, 2) by the indices of two cameras."""


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
        matrix = intrinsics(self.focal, self.focal, self.width / 2, self.height / 2)
        return Camera(name, self.width, self.height, matrix, np.vstack([pose, [0.0, 0.0, 0.0, 1.0]]))

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
        return np.asarray(1 + self.k1 * square + self.k2 * square**2)


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
        return list(np.flatnonzero(np.isfinite(self.poses).all(axis=(1, 2))).tolist())


def centers(model: Model) -> Float64s:
    """(images, 3) centres in the world."""
    return np.asarray(-np.einsum("nji,nj->ni", model.poses[:, :, :3], model.poses[:, :, 3]))


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
    return np.asarray(np.linalg.norm(scale * a @ (left * signs @ right).T - b, axis=1))


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
    return np.asarray(np.median(finite if len(finite) else centers(model)[model.placed], axis=0))


# --- points


@dataclass(frozen=True, eq=False)
class Tracks:
    """Observations of points, in order of their points.

    Attributes:
        points: (N,) int64 index of the point.
        cameras: (N,) int64 index of the camera.
        features: (N,) int64 index among the camera's features.
        pixels: (N, 2) float64.
        count: number of points.
    """

    points: Ints
    cameras: Ints
    features: Ints
    pixels: Float64s
    count: int

    def chosen(self, keep: Bools, least: int = 2) -> Tracks:
        """Those observations, of the points that keep at least so many, counted anew."""
        lengths = np.bincount(self.points[keep], minlength=self.count)
        keep = keep & (lengths[self.points] >= least)
        _, points = np.unique(self.points[keep], return_inverse=True)
        count = int(points.max()) + 1 if len(points) else 0
        return Tracks(points.astype(np.int64), self.cameras[keep], self.features[keep], self.pixels[keep], count)


def tracks_of(pairs: Pairs, pixels: Sequence[Float64s]) -> Tracks:
    """Matches joined to tracks. Of a track that sees one camera twice only its first observation there is kept.

    Args:
        pixels: (N, 2) of all features, for each camera.
    """
    starts = np.concatenate([[0], np.cumsum([len(pixel) for pixel in pixels])]).astype(np.int64)
    edges = [matches + starts[[one, other]] for (one, other), matches in sorted(pairs.items()) if len(matches)]
    if not edges:
        empty = np.empty(0, np.int64)
        return Tracks(empty, empty, empty, np.empty((0, 2)), 0)
    links = np.concatenate(edges)
    label, node = components(links[:, 0], links[:, 1], int(starts[-1])), np.unique(links)
    camera = np.searchsorted(starts, node, side="right") - 1
    order = np.lexsort((node, camera, label[node]))
    node, camera, point = node[order], camera[order], label[node][order]
    again = np.concatenate([[False], (point[1:] == point[:-1]) & (camera[1:] == camera[:-1])])
    everything = np.concatenate(list(pixels))
    tracks = Tracks(point, camera, node - starts[camera], everything[node], int(label.max()) + 1)
    return tracks.chosen(~again)


def triangulate(tracks: Tracks, model: Model, used: Bools | None = None) -> Float64s:
    """(count, 3) points in the world, NaN where fewer than two cameras see one or its rays are parallel.

    Args:
        used: (N,) which observations count; all by default.
    """
    rays = np.empty_like(tracks.pixels)  # in the plane at distance 1 before their cameras
    for camera, lens in enumerate(model.lenses):
        own = tracks.cameras == camera
        rays[own] = lens.rays(tracks.pixels[own])
    pose = model.poses[tracks.cameras]
    use = np.isfinite(pose).all(axis=(1, 2)) & (True if used is None else used)
    weight = use.astype(np.float64)
    points = _solve(tracks, rays, np.nan_to_num(pose), weight)
    for _ in range(2):  # weighed by depth, which makes the algebraic residual one of the image
        depth = np.einsum("nj,nj->n", pose[:, 2, :3], points[tracks.points]) + pose[:, 2, 3]
        weight = np.where(use & (np.abs(depth) > 1e-9), 1 / np.maximum(np.abs(depth), 1e-9), 0.0)
        points = _solve(tracks, rays, np.nan_to_num(pose), np.nan_to_num(weight))
    return points


def _solve(tracks: Tracks, rays: Float64s, pose: Float64s, weight: Float64s) -> Float64s:
    """(count, 3) points that minimise the weighted algebraic residuals of all rays (N, 2)."""
    rows = rays[:, :, None] * pose[:, None, 2] - pose[:, :2]  # (N, 2, 4)
    rows = rows * weight[:, None, None]
    normal = summed(rows.transpose(0, 2, 1) @ rows, tracks)
    lengths = np.bincount(tracks.points, weights=weight > 0, minlength=tracks.count)
    left, right = normal[:, :3, :3], -normal[:, :3, 3]
    trace = np.trace(left, axis1=1, axis2=2)
    sure = (lengths >= 2) & (np.linalg.det(left) > 1e-12 * np.maximum(trace, 1e-300) ** 3)
    points = np.full((tracks.count, 3), np.nan)
    points[sure] = np.linalg.solve(left[sure], right[sure][..., None])[..., 0]
    return points


def summed(values: Float64s, tracks: Tracks) -> Float64s:
    """(count, ...) sums over the observations (N, ...) of each point; observations are in order of their points."""
    if not tracks.count:
        return np.zeros((0, *values.shape[1:]))
    starts = np.searchsorted(tracks.points, np.arange(tracks.count))
    return np.add.reduceat(values, starts, axis=0)


def residuals(tracks: Tracks, points: Float64s, model: Model) -> Float64s:
    """(N,) distances in pixels of observations from their points; infinite where no point lies before the camera."""
    pose = model.poses[tracks.cameras]
    local = np.einsum("nij,nj->ni", pose[:, :, :3], points[tracks.points]) + pose[:, :, 3]
    distances = np.full(len(local), np.inf)
    before = np.isfinite(local).all(axis=1)
    before[before] = local[before, 2] > 1e-9
    for camera, lens in enumerate(model.lenses):
        own = before & (tracks.cameras == camera)
        distances[own] = np.linalg.norm(lens.pixels(local[own]) - tracks.pixels[own], axis=1)
    return distances


def located(tracks: Tracks, model: Model) -> tuple[Float64s, Float64s]:
    """Points (count, 3) without their worst observations, and the residuals (N,) of all observations."""
    limit = model.limits[tracks.cameras]
    points = triangulate(tracks, model)
    for _ in range(2):
        distances = residuals(tracks, points, model)
        worst = np.zeros(tracks.count)
        np.maximum.at(worst, tracks.points, np.where(np.isfinite(distances), distances, 0.0))
        lengths = np.bincount(tracks.points[distances <= limit], minlength=tracks.count)
        false = (distances > limit) & ((distances >= worst[tracks.points]) | (lengths[tracks.points] >= 2))
        points = triangulate(tracks, model, ~false)
    return points, residuals(tracks, points, model)


# --- what a calibration finds, as it goes from the child to its caller


@dataclass(frozen=True)
class CameraSupport:
    """What supports one camera.

    Attributes:
        observations: that agree with the model.
        share: of its observations that agree.
        shared_by_three: points that it sees together with two others at once.
        residual: median, pixels.
        coverage: share of 8 x 6 cells of its image that hold an observation.
        focal_uncertainty: standard deviation of the focal length over the focal length.
    """

    observations: int
    share: float
    shared_by_three: int
    residual: float
    coverage: float
    focal_uncertainty: float


@dataclass(frozen=True)
class PairSupport:
    """Two cameras by index: their matches, those that pass the two-view check, and those that agree with the model."""

    one: int
    other: int
    matches: int
    verified: int
    agreeing: int


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """One camera and what supports it.

    Attributes:
        camera: without its distortion; the principal point in the middle.
        distortion: k1 and k2 in OpenCV's order.
        support: what speaks for it.
        observations: (N, 3) some of its observations: x and y in pixels, and 1 for those that agree with the rest.
    """

    camera: Camera
    distortion: tuple[float, float]
    support: CameraSupport
    observations: Float64s


@dataclass(frozen=True, eq=False)
class Calibration:
    """The cameras of a rig. World: z up, y ahead, the origin where the cameras look; the scale is free.

    Attributes:
        cameras: in the order of the views.
        points: (N, 3) float64 points on surfaces.
        pairs: what connects the cameras, by their indices.
        halves_apart: how far cameras lie apart when half of the points are used each, over the rig's diameter; NaN
            where nothing compared them.
        warnings: one sentence each.
        is_metric: the scale is not free: lengths are metres.
        source: what the cameras come from.
    """

    cameras: tuple[CalibratedCamera, ...]
    points: Float64s = field(default_factory=lambda: np.empty((0, 3)))
    pairs: tuple[PairSupport, ...] = ()
    halves_apart: float = np.nan
    warnings: tuple[str, ...] = ()
    is_metric: bool = False
    source: str = "features"

    @property
    def known(self) -> Cameras:
        """The cameras for synchronization."""
        return {known.camera.name: (known.camera, np.array([*known.distortion, 0.0, 0.0])) for known in self.cameras}


@dataclass(frozen=True, eq=False)
class MovingCamera:
    """The posed images of a camera that moves.

    Attributes:
        lens: of the camera.
        placed: the images that have a pose, by their index among all.
        poses: (images, 3, 4) world to camera, of those.
        points: (N, 3) on surfaces.
        residual: median, pixels.
        focal_uncertainty: standard deviation of the focal length over the focal length, the largest.
        halves_apart: as of ``Calibration``, over the path's size.
        warnings: one sentence each.
    """

    lens: Lens
    placed: tuple[int, ...]
    poses: Float64s
    points: Float64s
    residual: float
    focal_uncertainty: float
    halves_apart: float
    warnings: tuple[str, ...] = ()
