"""What pycolmap does for calibration: two-view checks, the incremental mapper, and bundle adjustment.

It is loaded where it is needed, in the child process alone: a C++ error in it ends the process.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ...optional_imports import importing
from .limits import LEAST_MATCHES
from .model import Lens, Model, Pairs, Tracks, located

_TOLERANCES = (1e-5, 1e-7)
"""Of the cost, in each round: the first only tells which observations are false."""
_ITERATIONS = 60
_MOST_POINTS = 8000  # of a result
SOFT = 0.5
"""Of a false observation's residual: from there on the loss grows slowly."""


def load_pycolmap() -> Any:  # pycolmap's own types do not pass mypy's strict checks
    """pycolmap with its log turned down to errors.

    Raises:
        FrogError: if it is not installed, or cannot be loaded.
    """
    with importing("pycolmap", "Calibrating films needs pycolmap: pip install pycolmap."):
        import pycolmap
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    pycolmap.set_random_seed(0)
    return pycolmap


def verified(one: Lens, pixels: Float64s, other: Lens, other_pixels: Float64s, matches: Ints) -> Ints:
    """Those of the matches (M, 2) that agree with one geometry; the lenses' sizes count, their focal lengths do not."""
    if len(matches) < LEAST_MATCHES:
        return np.empty((0, 2), np.int64)
    pycolmap = load_pycolmap()
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = LEAST_MATCHES
    options.ransac.max_error = max(one.limit, other.limit)  # pixels by which a true match may miss its epipolar line
    options.ransac.random_seed = 0
    options.ransac.confidence = 0.9999
    options.detect_watermark = False  # which asks whether matches lie at the edge and do not move
    geometry = pycolmap.estimate_two_view_geometry(
        colmap_camera(one, 1), pixels, colmap_camera(other, 2), other_pixels, matches.astype(np.uint32), options
    )
    inliers = np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)
    return inliers if len(inliers) >= LEAST_MATCHES else np.empty((0, 2), np.int64)


def colmap_camera(lens: Lens, camera_id: int, free: int = 0) -> Any:  # pycolmap.Camera
    """The lens as pycolmap's camera, with so many of k1 and k2."""
    model = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")[free]
    camera = load_pycolmap().Camera.create_from_model_name(camera_id, model, lens.focal, lens.width, lens.height)
    parameters = [lens.focal, lens.width / 2, lens.height / 2, lens.k1, lens.k2]
    camera.params = np.array(parameters[: 3 + free])
    return camera


def undistorted_pixels(lens: Lens, pixels: Float64s) -> Float64s:
    """(N, 2) where a lens of the same focal length without distortion would see the same points."""
    if not (lens.k1 or lens.k2):
        return pixels
    return np.asarray(lens.focal * lens.rays(pixels) + np.array([lens.width / 2, lens.height / 2]))


def verified_again(matches: Pairs, pixels: Sequence[Float64s], lenses: Sequence[Lens]) -> Pairs:
    """The matches that pass the two-view check once distortion is known: before, those far off the middle fail it."""
    straight = [undistorted_pixels(lens, own) for lens, own in zip(lenses, pixels, strict=True)]
    return {
        (one, other): verified(lenses[one], straight[one], lenses[other], straight[other], rows)
        for (one, other), rows in matches.items()
    }


def incremental(
    lenses: Sequence[Lens], groups: Sequence[int], pixels: Sequence[Float64s], pairs: Pairs
) -> Model | None:
    """The largest model that the incremental mapper finds; None where it finds none.

    Args:
        lenses: sizes, and focal lengths to start from.
        groups: cameras of one group share their focal length.
        pixels: (N, 2) of all features, for each camera.
        pairs: verified matches.
    """
    pixels, pairs = _enough(pixels, pairs)
    with tempfile.TemporaryDirectory(prefix="frog-mapping-") as name:
        folder = Path(name)
        _write_database(folder / "database.db", lenses, groups, pixels, pairs)
        models = load_pycolmap().incremental_mapping(
            folder / "database.db", folder, folder, _mapper_options(max(lens.limit for lens in lenses), len(lenses))
        )
    return _largest(models, lenses)


def _enough(pixels: Sequence[Float64s], pairs: Pairs) -> tuple[Sequence[Float64s], Pairs]:
    """The same, or each feature several times where a pair has fewer matches than COLMAP starts from.

    Its least number is fixed for photographs, of whose matches some are false; that of points that were named is not.
    """
    fewest = min((len(matches) for matches in pairs.values() if len(matches)), default=LEAST_MATCHES)
    if fewest >= LEAST_MATCHES:
        return pixels, pairs
    times = ceil(2 * LEAST_MATCHES / fewest)
    counts = [len(features) for features in pixels]
    return [np.concatenate([features] * times) for features in pixels], {
        (one, other): np.concatenate([matches + np.array([counts[one], counts[other]]) * copy for copy in range(times)])
        for (one, other), matches in pairs.items()
    }


def _largest(models: Any, lenses: Sequence[Lens]) -> Model | None:  # pycolmap.Reconstruction by number
    """The model that places most images; None without any."""
    if not models:
        return None
    best = max(models.values(), key=lambda model: (model.num_reg_images(), model.compute_num_observations()))
    poses, lenses = np.full((len(lenses), 3, 4), np.nan), list(lenses)
    for image_id in best.reg_image_ids():
        image = best.image(image_id)
        poses[image_id - 1] = image.cam_from_world().matrix()
        lenses[image_id - 1] = replace(lenses[image_id - 1], focal=float(image.camera.params[0]))
    return Model(poses, tuple(lenses))


def _mapper_options(limit: float, images: int) -> Any:  # pycolmap.IncrementalPipelineOptions
    pipeline = load_pycolmap().IncrementalPipelineOptions()
    pipeline.min_num_matches = pipeline.mapper.abs_pose_min_num_inliers = LEAST_MATCHES
    pipeline.min_model_size = min(3, images)
    pipeline.multiple_models = pipeline.extract_colors = False
    pipeline.ba_refine_extra_params = pipeline.ba_refine_principal_point = False
    pipeline.random_seed = 0
    pipeline.num_threads = 1  # several starts are mapped at once
    pipeline.mapper.init_min_num_inliers = 2 * LEAST_MATCHES
    pipeline.mapper.init_max_error = pipeline.mapper.filter_max_reproj_error = limit
    pipeline.mapper.abs_pose_max_error = 3 * limit
    pipeline.triangulation.merge_max_reproj_error = pipeline.triangulation.complete_max_reproj_error = limit
    pipeline.triangulation.ignore_two_view_tracks = False
    return pipeline


def _write_database(
    path: Path, lenses: Sequence[Lens], groups: Sequence[int], pixels: Sequence[Float64s], pairs: Pairs
) -> None:
    """COLMAP's database: image i + 1 is camera i, and the camera's number is its group's."""
    pycolmap = load_pycolmap()
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for group in sorted(set(groups)):
            lens = lenses[list(groups).index(group)]
            database.write_camera(colmap_camera(lens, group + 1), True)
        for image_id, group in enumerate(groups, 1):
            database.write_image(pycolmap.Image(f"{image_id:06d}", camera_id=group + 1, image_id=image_id), True)
            database.write_keypoints(image_id, pixels[image_id - 1].astype(np.float32))
        for (one, other), matches in pairs.items():
            kind = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
            geometry = pycolmap.TwoViewGeometry(config=kind, inlier_matches=matches.astype(np.uint32))
            database.write_two_view_geometry(one + 1, other + 1, geometry)


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A model after bundle adjustment.

    Attributes:
        model: with the adjusted poses and lenses.
        tracks: that it was adjusted to.
        points: (count, 3) of the tracks' points, NaN for those that were not located.
        distances: (N,) residuals in pixels of all observations.
        uncertainty: standard deviation of the focal length over the focal length, for each camera; infinite where the
            data do not fix it.
    """

    model: Model
    tracks: Tracks
    points: Float64s
    distances: Float64s
    uncertainty: Float64s

    @property
    def agree(self) -> Bools:
        """(N,) which observations lie within the limit of a point that is located."""
        return np.asarray(self.distances <= self.model.limits[self.tracks.cameras])

    @property
    def cost(self) -> float:
        """Mean squared residual in units of the limit, each at most 1."""
        shares = np.minimum(self.distances / self.model.limits[self.tracks.cameras], 1.0)
        return float(np.mean(shares**2)) if len(shares) else 1.0

    @property
    def unsure(self) -> float:
        """The largest uncertainty of an image that has a pose."""
        return float(self.uncertainty[self.model.placed].max())

    def sure_points(self, least: int) -> Ints:
        """Points that at least so many observations agree about, the best seen ones first."""
        lengths = np.bincount(self.tracks.points[self.agree], minlength=self.tracks.count)
        sure = np.flatnonzero((lengths >= least) & np.isfinite(self.points).all(axis=1))
        return np.asarray(sure[np.argsort(-lengths[sure], kind="stable")][:_MOST_POINTS])


def adjust(model: Model, tracks: Tracks, groups: Sequence[int], coefficients: Sequence[int]) -> Adjusted:
    """Poses, focal lengths, distortion and points that fit the tracks best.

    Args:
        model: where to start; cameras without a pose stay so.
        groups: cameras of one group share their lens.
        coefficients: for each camera how many of k1 and k2 are free: 0, 1 or 2. The others are taken as zero.
    """
    adjusted = Adjusted(model, tracks, *located(tracks, model), np.full(len(model.lenses), np.inf))
    for tolerance in _TOLERANCES:
        used = adjusted.agree
        lengths = np.bincount(tracks.points[used], minlength=tracks.count)
        used &= lengths[tracks.points] >= 2
        if not used.any():
            break
        model, uncertainty = _solve(adjusted, used, groups, coefficients, tolerance)
        adjusted = Adjusted(model, tracks, *located(tracks, model), uncertainty)
    return adjusted


def _solve(
    adjusted: Adjusted, used: Bools, groups: Sequence[int], coefficients: Sequence[int], tolerance: float
) -> tuple[Model, Float64s]:
    """One adjustment of the used observations, and the focal lengths' relative standard deviations."""
    pycolmap = load_pycolmap()
    model = adjusted.model
    reconstruction, config = _reconstruction(adjusted, used, groups, coefficients)
    options = adjustment_options(SOFT * min(lens.limit for lens in model.lenses), _ITERATIONS)
    options.ceres.solver_options.function_tolerance = tolerance
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    adjuster.solve()
    intrinsics = pycolmap.BACovarianceOptions()
    intrinsics.params = pycolmap.BACovarianceOptionsParams.ALL
    covariance = pycolmap.estimate_ba_covariance(intrinsics, reconstruction, adjuster)
    noise = np.sqrt(np.mean(adjusted.distances[used] ** 2) / 2)  # a coordinate's
    poses, lenses = model.poses.copy(), list(model.lenses)
    uncertainty = np.full(len(lenses), np.inf)
    for index in model.placed:
        image = reconstruction.image(index + 1)
        poses[index] = image.cam_from_world().matrix()
        parameters = np.asarray(image.camera.params, np.float64)
        k1, k2 = (*parameters[3:].tolist(), 0.0, 0.0)[:2]
        lenses[index] = replace(lenses[index], focal=float(parameters[0]), k1=k1, k2=k2)
        variances = covariance.get_other_params_cov(image.camera.params) if covariance is not None else None
        if variances is not None and parameters[0] > 0:
            uncertainty[index] = noise * np.sqrt(max(float(variances[0, 0]), 0.0)) / parameters[0]
    return Model(poses, tuple(lenses)), uncertainty


def adjustment_options(loss: float, iterations: int) -> Any:  # pycolmap.BundleAdjustmentOptions
    """With Cauchy's loss from so many pixels on."""
    pycolmap = load_pycolmap()
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.max_num_iterations = iterations
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss
    return options


def _reconstruction(
    adjusted: Adjusted, used: Bools, groups: Sequence[int], coefficients: Sequence[int]
) -> tuple[Any, Any]:  # pycolmap.Reconstruction, pycolmap.BundleAdjustmentConfig
    """The model and its used observations as pycolmap's; image i + 1 is camera i."""
    pycolmap = load_pycolmap()
    model, tracks = adjusted.model, adjusted.tracks
    reconstruction, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
    known: set[int] = set()
    rows = np.zeros(len(tracks.points), np.int64)
    for index in model.placed:
        group = groups[index]
        if group not in known:
            known.add(group)
            camera = colmap_camera(model.lenses[index], group + 1, coefficients[index])
            reconstruction.add_camera_with_trivial_rig(camera)
        own = np.flatnonzero(used & (tracks.cameras == index))
        rows[own] = np.arange(len(own))
        image = pycolmap.Image(
            f"{index + 1:06d}", keypoints=tracks.pixels[own], camera_id=group + 1, image_id=index + 1
        )
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(model.poses[index]))
        config.add_image(index + 1)
    order = np.flatnonzero(used)
    for own in np.split(order, np.flatnonzero(np.diff(tracks.points[order])) + 1):
        track = pycolmap.Track()
        for camera, row in zip(tracks.cameras[own].tolist(), rows[own].tolist(), strict=True):
            track.add_element(camera + 1, row)
        reconstruction.add_point3D(adjusted.points[tracks.points[own[0]]], track)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return reconstruction, config
