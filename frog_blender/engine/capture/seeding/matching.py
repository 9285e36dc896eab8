"""Sparse seed points: SIFT features matched between views and triangulated with the known cameras."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...arrays import Float32s, Float64s, ImageArray, Ints
from ..camera import Camera
from ..epipolar import fundamental, sampson_table
from ..video import load_opencv
from .views import View

_FEATURES = 2500  # an image
_RATIO = 0.8  # best to second best descriptor distance
_FARTHEST = 0.7  # descriptors of a match
_EPIPOLAR_PIXELS = 2.0
_MIN_PARALLAX = np.radians(1.0)

Features = tuple[Float64s, Float32s]


def describe(view: View) -> Features:
    """Positions (N, 2) in pixels and unit-free descriptors (N, 128) of the SIFT features of a view."""
    cv2 = load_opencv()
    return root_sift(cv2.cvtColor((view.image * 255).astype(np.uint8), cv2.COLOR_RGB2GRAY), _FEATURES, 0.02)


def root_sift(gray: ImageArray, count: int, contrast: float) -> Features:
    """The same of brightness (H, W) uint8, of at most ``count`` features above a contrast."""
    cv2 = load_opencv()
    points, descriptors = cv2.SIFT_create(nfeatures=count, contrastThreshold=contrast).detectAndCompute(gray, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    positions = np.array([point.pt for point in points], dtype=np.float64) + 0.5  # OpenCV counts centres from 0
    return positions, np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))


def mutual_matches(similarity: Float32s) -> tuple[Ints, Ints]:
    """Rows and columns of features (N, M) that are each other's best, and better than the row's second best by far."""
    rows, best, back = np.arange(len(similarity)), similarity.argmax(axis=1), similarity.argmax(axis=0)
    score = similarity[rows, best]
    similarity[rows, best] = -1.0
    second_score = similarity.max(axis=1)
    similarity[rows, best] = score
    apart, next_apart = (np.sqrt(np.maximum(2 - 2 * scores, 0)) for scores in (score, second_score))
    keep = (back[best] == rows) & (apart < _RATIO * next_apart)
    return rows[keep], best[keep]


def triangulate_pair(first: View, second: View, features: tuple[Features, Features]) -> tuple[Float64s, Float32s]:
    """World points (N, 3) matched between two views and their colours (N, 3) in [0, 1]."""
    cv2 = load_opencv()
    (positions_a, descriptors_a), (positions_b, descriptors_b) = features
    if min(len(positions_a), len(positions_b)) < 8:
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    similarity = descriptors_a @ descriptors_b.T
    # Only matches on the epipolar line compete: repeated patterns (bricks, tiles) then still have one best match.
    error = np.abs(sampson_table(fundamental(first.camera, second.camera), positions_a, positions_b))
    similarity[error > 4 * _EPIPOLAR_PIXELS] = -1.0
    rows, best = mutual_matches(similarity)
    keep = (2 - 2 * similarity[rows, best] < _FARTHEST**2) & (error[rows, best] < _EPIPOLAR_PIXELS)
    pixels_a, pixels_b = positions_a[rows[keep]], positions_b[best[keep]]
    if len(pixels_a) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    homogeneous = cv2.triangulatePoints(_projection(first.camera), _projection(second.camera), pixels_a.T, pixels_b.T)
    safe = np.where(np.abs(homogeneous[3]) < 1e-12, 1e-12, homogeneous[3])
    points = (homogeneous[:3] / safe).T
    good = np.isfinite(points).all(axis=1)
    for camera, pixels in ((first.camera, pixels_a), (second.camera, pixels_b)):
        projected, depths = camera.project(points)
        good &= (depths > 0) & (np.linalg.norm(projected - pixels, axis=1) < _EPIPOLAR_PIXELS)
    rays = [points - view.camera.center for view in (first, second)]
    lengths = np.linalg.norm(rays[0], axis=1) * np.linalg.norm(rays[1], axis=1)
    angle = np.arccos(np.clip((rays[0] * rays[1]).sum(axis=1) / np.maximum(lengths, 1e-12), -1, 1))
    good &= angle > _MIN_PARALLAX
    columns, lines = pixels_a[good].astype(int).T
    return points[good], first.image[lines, columns]


def triangulate(pairs: Iterable[tuple[View, View]]) -> tuple[Float64s, Float32s]:
    """World points (N, 3) and colours (N, 3) in [0, 1] from all pairs of views; features are found once a view."""
    known: dict[int, Features] = {}
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3), np.float32)]
    for first, second in pairs:
        for view in (first, second):
            if view.shot not in known:
                known[view.shot] = describe(view)
        found = triangulate_pair(first, second, (known[first.shot], known[second.shot]))
        points.append(found[0])
        colors.append(found[1])
    return np.concatenate(points), np.concatenate(colors)


def _projection(camera: Camera) -> Float64s:
    """(3, 4) matrix from the world to homogeneous pixels."""
    return camera.intrinsics @ camera.world_to_camera[:3]
