"""Points that several cameras see: matches joined across pairs of cameras, triangulated, and judged by their residuals.

One measure serves every comparison of solutions: the truncated squared reprojection residual of the same observations.
A low mean residual says nothing, since bad solutions lose the observations that would raise it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ...graphs import components
from .model import Model

Pairs = Mapping[tuple[int, int], Ints]
"""Indices of matching features (M, 2) by the indices of two cameras."""


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


def join(pairs: Pairs, pixels: Sequence[Float64s]) -> Tracks:
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
