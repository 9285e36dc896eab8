"""Matches of two cameras that agree with one fundamental matrix, and the rotation between the cameras."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import Float64s, Ints
from .colmap import load_pycolmap
from .lens import Lens

LEAST_MATCHES = 15
"""Matches that a pair of cameras must have after the check."""


def options(limit: float, *, with_pose: bool = False) -> Any:  # pycolmap.TwoViewGeometryOptions
    """The options of every two-view check: equal seeds give equal results.

    Args:
        limit: pixels by which a true match may miss its epipolar line.
    """
    found = load_pycolmap().TwoViewGeometryOptions()
    found.min_num_inliers = LEAST_MATCHES
    found.ransac.max_error = limit
    found.ransac.random_seed = 0
    found.ransac.confidence = 0.9999
    found.detect_watermark = False  # which asks whether matches lie at the edge and do not move
    found.compute_relative_pose = with_pose
    return found


def verified(one: Lens, pixels: Float64s, other: Lens, other_pixels: Float64s, matches: Ints) -> Ints:
    """Those of the matches (M, 2) that agree with one geometry; the lenses' sizes count, their focal lengths do not."""
    if len(matches) < LEAST_MATCHES:
        return np.empty((0, 2), np.int64)
    geometry = load_pycolmap().estimate_two_view_geometry(
        colmap_camera(one, 1, "SIMPLE_PINHOLE"),
        pixels,
        colmap_camera(other, 2, "SIMPLE_PINHOLE"),
        other_pixels,
        matches.astype(np.uint32),
        options(max(one.limit, other.limit)),
    )
    inliers = np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)
    return inliers if len(inliers) >= LEAST_MATCHES else np.empty((0, 2), np.int64)


def relative_rotation(
    one: Lens, pixels: Float64s, other: Lens, other_pixels: Float64s, matches: Ints
) -> Float64s | None:
    """(3, 3) rotation from one camera's axes to the other's, by the lenses' focal lengths; None where none is found."""
    pycolmap = load_pycolmap()
    geometry = pycolmap.estimate_calibrated_two_view_geometry(
        colmap_camera(one, 1, "SIMPLE_PINHOLE"),
        undistorted_pixels(one, pixels),
        colmap_camera(other, 2, "SIMPLE_PINHOLE"),
        undistorted_pixels(other, other_pixels),
        matches.astype(np.uint32),
        options(max(one.limit, other.limit), with_pose=True),
    )
    pose = geometry.cam2_from_cam1
    return None if pose is None else np.asarray(pose.rotation.matrix(), np.float64)


def colmap_camera(lens: Lens, number: int, model: str) -> Any:  # pycolmap.Camera
    """The lens as pycolmap's camera; a model without distortion leaves k1 and k2 out."""
    parameters = {
        "SIMPLE_PINHOLE": [lens.focal, lens.width / 2, lens.height / 2],
        "SIMPLE_RADIAL": [lens.focal, lens.width / 2, lens.height / 2, lens.k1],
        "RADIAL": [lens.focal, lens.width / 2, lens.height / 2, lens.k1, lens.k2],
    }[model]
    camera = load_pycolmap().Camera.create_from_model_name(number, model, lens.focal, lens.width, lens.height)
    camera.params = np.array(parameters)
    return camera


def undistorted_pixels(lens: Lens, pixels: Float64s) -> Float64s:
    """(N, 2) where a lens of the same focal length without distortion would see the same points."""
    if not (lens.k1 or lens.k2):
        return pixels
    moved: Float64s = lens.focal * lens.rays(pixels) + np.array([lens.width / 2, lens.height / 2])
    return moved
