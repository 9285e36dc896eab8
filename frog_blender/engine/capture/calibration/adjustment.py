"""Bundle adjustment of a model over its tracks, and how sure its focal lengths are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Bools, Float64s
from .colmap import load_pycolmap
from .lens import Lens
from .mapping import Model
from .tracks import Tracks, located
from .two_view import colmap_camera

_MODELS = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_TOLERANCES = (1e-5, 1e-7)
"""Of the cost, in each round: the first only tells which observations are false."""
_SOFT = 0.5  # of a false observation's residual: from there on the loss grows slowly


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A model after bundle adjustment.

    Attributes:
        model: with the adjusted poses and lenses.
        points: (count, 3) of the tracks' points, NaN for those that were not located.
        distances: (N,) residuals in pixels of all observations.
        uncertainty: standard deviation of the focal length over the focal length, for each camera; infinite where the
            data do not fix it.
    """

    model: Model
    points: Float64s
    distances: Float64s
    uncertainty: Float64s


def adjust(model: Model, tracks: Tracks, groups: Sequence[int], coefficients: Sequence[int]) -> Adjusted:
    """Poses, focal lengths, distortion and points that fit the tracks best.

    Args:
        model: where to start; cameras without a pose stay so.
        groups: cameras of one group share their lens.
        coefficients: for each camera how many of k1 and k2 are free: 0, 1 or 2. The others are taken as zero.
    """
    limits = np.array([lens.limit for lens in model.lenses])
    uncertainty = np.full(len(model.lenses), np.inf)
    for tolerance in _TOLERANCES:
        points, distances = located(tracks, model.poses, model.lenses, limits)
        used = (distances <= limits[tracks.cameras]) & np.isfinite(points).all(axis=1)[tracks.points]
        lengths = np.bincount(tracks.points[used], minlength=tracks.count)
        used &= lengths[tracks.points] >= 2
        if not used.any():
            break
        model, uncertainty = _solve(model, (tracks, used, points, distances), groups, coefficients, tolerance)
    points, distances = located(tracks, model.poses, model.lenses, limits)
    return Adjusted(model, points, distances, uncertainty)


def _solve(
    model: Model,
    seen: tuple[Tracks, Bools, Float64s, Float64s],
    groups: Sequence[int],
    coefficients: Sequence[int],
    tolerance: float,
) -> tuple[Model, Float64s]:
    """One adjustment of the used observations, and the focal lengths' relative standard deviations."""
    pycolmap = load_pycolmap()
    reconstruction, config = _reconstruction(model, seen, groups, coefficients)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.function_tolerance = tolerance
    options.ceres.solver_options.max_num_iterations = 60
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = _SOFT * min(lens.limit for lens in model.lenses)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    adjuster.solve()
    covariance = pycolmap.estimate_ba_covariance(_intrinsics_only(), reconstruction, adjuster)
    _, used, _, distances = seen
    noise = np.sqrt(np.mean(distances[used] ** 2) / 2)  # a coordinate's
    poses, lenses = model.poses.copy(), list(model.lenses)
    uncertainty = np.full(len(lenses), np.inf)
    for index in model.placed:
        image = reconstruction.image(index + 1)
        poses[index] = image.cam_from_world().matrix()
        parameters = np.asarray(image.camera.params, np.float64)
        k1, k2 = (*parameters[3:].tolist(), 0.0, 0.0)[:2]
        lenses[index] = replace(lenses[index], focal=float(parameters[0]), k1=k1, k2=k2)
        found = covariance.get_other_params_cov(image.camera.params) if covariance is not None else None
        if found is not None and parameters[0] > 0:
            uncertainty[index] = noise * np.sqrt(max(float(found[0, 0]), 0.0)) / parameters[0]
    return Model(poses, tuple(lenses)), uncertainty


def _intrinsics_only() -> Any:  # pycolmap.BACovarianceOptions
    pycolmap = load_pycolmap()
    options = pycolmap.BACovarianceOptions()
    options.params = pycolmap.BACovarianceOptionsParams.ALL
    return options


def _reconstruction(
    model: Model,
    seen: tuple[Tracks, Bools, Float64s, Float64s],
    groups: Sequence[int],
    coefficients: Sequence[int],
) -> tuple[Any, Any]:  # pycolmap.Reconstruction, pycolmap.BundleAdjustmentConfig
    """The model and its used observations as pycolmap's; image i + 1 is camera i."""
    pycolmap = load_pycolmap()
    tracks, used, points, _ = seen
    reconstruction, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
    known: set[int] = set()
    places = np.zeros(len(tracks.points), np.int64)
    for index in model.placed:
        group = groups[index]
        if group not in known:
            known.add(group)
            lens = _within(model.lenses[index], coefficients[index])
            camera = colmap_camera(lens, group + 1, _MODELS[coefficients[index]])
            reconstruction.add_camera_with_trivial_rig(camera)
        own = np.flatnonzero(used & (tracks.cameras == index))
        places[own] = np.arange(len(own))
        image = pycolmap.Image(
            f"{index + 1:06d}", keypoints=tracks.pixels[own], camera_id=group + 1, image_id=index + 1
        )
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(model.poses[index]))
        config.add_image(index + 1)
    order = np.flatnonzero(used)
    for own in np.split(order, np.flatnonzero(np.diff(tracks.points[order])) + 1):
        track = pycolmap.Track()
        for camera, place in zip(tracks.cameras[own].tolist(), places[own].tolist(), strict=True):
            track.add_element(camera + 1, place)
        reconstruction.add_point3D(points[tracks.points[own[0]]], track)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return reconstruction, config


def _within(lens: Lens, coefficients: int) -> Lens:
    """The lens without the coefficients that are not free."""
    return replace(lens, k1=lens.k1 if coefficients > 0 else 0.0, k2=lens.k2 if coefficients > 1 else 0.0)
