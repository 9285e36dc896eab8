"""COLMAP's incremental mapper on features that were pooled before: one COLMAP image for each standing camera."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Float64s
from ..video import load_opencv
from .colmap import load_pycolmap
from .lens import Lens
from .tracks import Pairs
from .two_view import LEAST_MATCHES, colmap_camera

_UNCALIBRATED = 3  # pycolmap.TwoViewGeometryConfiguration


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
    def placed(self) -> list[int]:
        """The cameras that have a pose."""
        found: list[int] = np.flatnonzero(np.isfinite(self.poses).all(axis=(1, 2))).tolist()
        return found


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
    pycolmap = load_pycolmap()
    with tempfile.TemporaryDirectory(prefix="frog-mapping-") as name:
        folder = Path(name)
        _write_database(folder / "database.db", lenses, groups, pixels, pairs)
        models = pycolmap.incremental_mapping(
            folder / "database.db", folder, folder, _options(max(lens.limit for lens in lenses))
        )
    return _largest(models, lenses)


def global_(lenses: Sequence[Lens], groups: Sequence[int], pixels: Sequence[Float64s], pairs: Pairs) -> Model | None:
    """What COLMAP's global mapper finds, faster for many images; parameters as of ``incremental``.

    It is catastrophic where focal lengths are unknown and geometry is poor: its result must be compared.
    """
    pycolmap = load_pycolmap()
    with tempfile.TemporaryDirectory(prefix="frog-mapping-") as name:
        folder = Path(name)
        _write_database(folder / "database.db", lenses, groups, pixels, pairs)
        calibration = pycolmap.ViewGraphCalibrationOptions()
        calibration.random_seed = 0
        pycolmap.calibrate_view_graph(folder / "database.db", calibration)
        pipeline = pycolmap.GlobalPipelineOptions()
        pipeline.random_seed = 0
        pipeline.min_num_matches = LEAST_MATCHES
        models = pycolmap.global_mapping(folder / "database.db", folder, folder, pipeline)
    return _largest(models, lenses)


def _largest(models: Any, lenses: Sequence[Lens]) -> Model | None:  # pycolmap.Reconstruction by number
    """The model that places most images; None without any."""
    if not models:
        return None
    best = max(models.values(), key=lambda model: (model.num_reg_images(), model.compute_num_observations()))
    poses = np.full((len(lenses), 3, 4), np.nan)
    found = list(lenses)
    for number in best.reg_image_ids():
        image = best.image(number)
        poses[number - 1] = image.cam_from_world().matrix()
        lens = lenses[number - 1]
        found[number - 1] = Lens(lens.width, lens.height, float(image.camera.params[0]))
    return Model(poses, tuple(found))


def _options(limit: float) -> Any:  # pycolmap.IncrementalPipelineOptions
    pipeline = load_pycolmap().IncrementalPipelineOptions()
    pipeline.min_num_matches = LEAST_MATCHES
    pipeline.multiple_models = False
    pipeline.min_model_size = 3
    pipeline.extract_colors = False
    pipeline.random_seed = 0
    pipeline.num_threads = 1  # several starts are mapped at once
    pipeline.ba_refine_extra_params = False
    pipeline.ba_refine_principal_point = False
    pipeline.mapper.init_min_num_inliers = 2 * LEAST_MATCHES
    pipeline.mapper.init_max_error = limit
    pipeline.mapper.abs_pose_max_error = 3 * limit
    pipeline.mapper.abs_pose_min_num_inliers = LEAST_MATCHES
    pipeline.mapper.filter_max_reproj_error = limit
    pipeline.triangulation.merge_max_reproj_error = limit
    pipeline.triangulation.complete_max_reproj_error = limit
    pipeline.triangulation.ignore_two_view_tracks = False
    return pipeline


def _fundamental(one: Float64s, other: Float64s) -> Float64s | None:
    """(3, 3) the fundamental matrix of verified matches (M, 2) each; None where they do not fix it."""
    cv2 = load_opencv()
    found, _ = cv2.findFundamentalMat(one, other, cv2.FM_8POINT)
    return None if found is None or found.shape != (3, 3) else np.asarray(found, np.float64)


def _write_database(
    path: Path, lenses: Sequence[Lens], groups: Sequence[int], pixels: Sequence[Float64s], pairs: Pairs
) -> None:
    """COLMAP's database: image i + 1 is camera i, and the camera's number is its group's."""
    pycolmap = load_pycolmap()
    database = pycolmap.Database.open(path)
    try:
        with pycolmap.DatabaseTransaction(database):
            for group in sorted(set(groups)):
                lens = lenses[list(groups).index(group)]
                database.write_camera(colmap_camera(lens, group + 1, "SIMPLE_PINHOLE"), True)
            for index, group in enumerate(groups):
                number = index + 1
                database.write_image(pycolmap.Image(f"{number:06d}", camera_id=group + 1, image_id=number), True)
                database.write_keypoints(number, pixels[index].astype(np.float32))
            for (one, other), matches in pairs.items():
                if not len(matches):
                    continue
                indices = matches.astype(np.uint32)
                database.write_matches(one + 1, other + 1, indices)
                geometry = pycolmap.TwoViewGeometry(
                    config=pycolmap.TwoViewGeometryConfiguration(_UNCALIBRATED), inlier_matches=indices
                )
                fundamental = _fundamental(pixels[one][matches[:, 0]], pixels[other][matches[:, 1]])
                if fundamental is None:
                    continue
                geometry.F = fundamental
                database.write_two_view_geometry(one + 1, other + 1, geometry)
    finally:
        database.close()
