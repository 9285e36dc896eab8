"""Sparse seed points: SIFT features matched between views and triangulated with the known cameras."""

import numpy as np

from ...arrays import Float32s, Float64s, ImageArray
from ..camera import Camera
from ..epipolar import fundamental, mutual, sampson_table
from ..video import load_opencv
from .views import Cloud, View, cloud_of, joined

_FEATURES = 2500  # an image
RATIO = 0.8  # best to second best descriptor distance
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


def triangulate_pair(first: View, second: View, features: tuple[Features, Features]) -> Cloud:
    """Points matched between two views, in the colours of the first."""
    cv2 = load_opencv()
    (positions_a, descriptors_a), (positions_b, descriptors_b) = features
    if min(len(positions_a), len(positions_b)) < 8:
        return joined([])
    similarity = descriptors_a @ descriptors_b.T
    # Only matches on the epipolar line compete: repeated patterns (bricks, tiles) then still have one best match.
    error = np.abs(sampson_table(fundamental(first.camera, second.camera), positions_a, positions_b))
    similarity[error > 4 * _EPIPOLAR_PIXELS] = -1.0
    rows, best = mutual(similarity, RATIO, _FARTHEST)
    near = error[rows, best] < _EPIPOLAR_PIXELS
    if not near.any():
        return joined([])
    pixels_a, pixels_b = positions_a[rows[near]], positions_b[best[near]]
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
    return cloud_of(points[good], first.image[lines, columns])


def _projection(camera: Camera) -> Float64s:
    """(3, 4) matrix from the world to homogeneous pixels."""
    return camera.intrinsics @ camera.world_to_camera[:3]
