"""A board that moves before standing cameras, adjusted by COLMAP: seen from the board, they are a rig that moves.

The board's corners stay where they are, each common time is a pose of the rig, and the cameras stand within it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Bools, Float64s, Ints
from .colmap import MODELS, load_pycolmap
from .points import CameraFacts

FOCAL, K1, K2, CENTER_X, CENTER_Y = range(5)
"""Columns of ``BoardRig.lenses``: focal length in pixels, two radial coefficients, principal point in pixels."""
_ORDER = [FOCAL, CENTER_X, CENTER_Y, K1, K2]  # of COLMAP's parameters
_NEAREST = 1e-6  # depth below which a point counts as behind the camera
_BEHIND = 1e3  # pixels of residual of a point behind its camera: worse than any in front of it
_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class Corners3D:
    """Who saw which corner when, M rows.

    Attributes:
        cameras, frames: (M,) index of the camera, and of the common time.
        places: (M, 3) the corner in the board's own axes.
        pixels: (M, 2) where it was seen.
    """

    cameras: Ints
    frames: Ints
    places: Float64s
    pixels: Float64s

    def where(self, chosen: Bools) -> Corners3D:
        """The chosen rows; frames keep their numbers."""
        return Corners3D(self.cameras[chosen], self.frames[chosen], self.places[chosen], self.pixels[chosen])


@dataclass(frozen=True, eq=False)
class BoardRig:
    """What is solved for.

    Attributes:
        facts: of the cameras.
        lenses: (C, 5), see FOCAL.
        cameras: (C, 4, 4) world to camera; the first one's axes are the world's.
        boards: (F, 4, 4) board to world at each common time.
        sigmas: (C, 5) standard deviations of the lenses (pixels; the focal length relative); 0 where one was held.
    """

    facts: tuple[CameraFacts, ...]
    lenses: Float64s
    cameras: Float64s
    boards: Float64s
    sigmas: Float64s

    def local(self, seen: Corners3D) -> Float64s:
        """(M, 3) the corners in their cameras' axes."""
        poses = self.cameras[seen.cameras] @ self.boards[seen.frames]
        found: Float64s = np.einsum("mij,mj->mi", poses[:, :3, :3], seen.places) + poses[:, :3, 3]
        return found

    def distances(self, seen: Corners3D) -> Float64s:
        """(M,) pixels between where corners were seen and where the rig puts them; many behind a camera."""
        local, lens = self.local(seen), self.lenses[seen.cameras]
        is_behind = local[:, 2] < _NEAREST
        flat = local[:, :2] / np.where(is_behind, 1.0, local[:, 2])[:, None]
        square = (flat**2).sum(axis=1)
        grown = lens[:, FOCAL] * (1.0 + square * (lens[:, K1] + square * lens[:, K2]))
        off = np.linalg.norm(grown[:, None] * flat + lens[:, CENTER_X:] - seen.pixels, axis=1)
        return np.where(is_behind, _BEHIND, off)


@dataclass(frozen=True)
class Freedom:
    """What an adjustment may change besides the boards.

    Attributes:
        coefficients: for each camera how many of k1 and k2 are free beside its focal length; none: no lens is.
        centers: principal points.
        poses: the cameras'.
    """

    coefficients: tuple[int, ...] = ()
    centers: bool = False
    poses: bool = True


def adjust_rig(rig: BoardRig, seen: Corners3D, free: Freedom, loss: float) -> BoardRig:
    """The rig that explains the corners best, from a start near it; frames without a corner stay.

    Args:
        loss: Cauchy's scale in pixels.
    """
    reconstruction, adjuster = _problem(rig, seen, free, loss)
    adjuster.solve()
    lenses, cameras, boards = rig.lenses.copy(), rig.cameras.copy(), rig.boards.copy()
    for index in range(len(rig.facts)):
        camera = reconstruction.camera(index + 1)
        lenses[index, _ORDER[: len(camera.params)]] = camera.params
        if index:
            cameras[index, :3] = reconstruction.rig(1).sensor_from_rig(camera.sensor_id).matrix()
    for number in reconstruction.frames:
        boards[number - 1, :3] = reconstruction.frame(number).rig_from_world.matrix()
    found = replace(rig, lenses=lenses, cameras=cameras, boards=boards)
    if not free.coefficients:
        return found
    sigmas = [_sigmas(found, seen.where(seen.cameras == index), index, free, loss) for index in range(len(rig.facts))]
    return replace(found, sigmas=np.stack(sigmas))


def _sigmas(rig: BoardRig, seen: Corners3D, camera: int, free: Freedom, loss: float) -> Float64s:
    """(5,) of one camera's lens, as if it had seen the board alone: pycolmap has no covariance of rigs."""
    pycolmap = load_pycolmap()
    boards = rig.cameras[camera] @ rig.boards
    alone = replace(
        rig, facts=(rig.facts[camera],), lenses=rig.lenses[[camera]], cameras=np.eye(4)[None], boards=boards
    )
    own = replace(seen, cameras=np.zeros_like(seen.cameras))
    reconstruction, adjuster = _problem(alone, own, replace(free, coefficients=(free.coefficients[camera],)), loss)
    options = pycolmap.BACovarianceOptions()
    options.params = pycolmap.BACovarianceOptionsParams.ALL
    covariance = pycolmap.estimate_ba_covariance(options, reconstruction, adjuster)
    known = None if covariance is None else covariance.get_other_params_cov(reconstruction.camera(1).params)
    if known is None:
        return np.full(5, np.inf)
    distances = rig.distances(seen)
    weights = 1.0 / (1.0 + (distances / loss) ** 2)
    noise = np.sqrt((weights * distances**2).sum() / max(2.0 * weights.sum(), 1.0))
    columns = [FOCAL, *([CENTER_X, CENTER_Y] if free.centers else []), *[K1, K2][: free.coefficients[camera]]]
    sigmas = np.zeros(5)
    sigmas[columns] = noise * np.sqrt(np.maximum(np.diag(known), 0.0))
    sigmas[FOCAL] /= rig.lenses[camera, FOCAL]
    return sigmas


def _problem(rig: BoardRig, seen: Corners3D, free: Freedom, loss: float) -> tuple[Any, Any]:
    """pycolmap's reconstruction and bundle adjuster: an image for each camera and time that shows the board."""
    pycolmap = load_pycolmap()
    reconstruction, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
    colmap_rig = pycolmap.Rig(rig_id=1)
    for index, facts in enumerate(rig.facts):
        lens, model = rig.lenses[index], MODELS[free.coefficients[index] if free.coefficients else -1]
        camera = pycolmap.Camera.create_from_model_name(index + 1, model, lens[FOCAL], facts.width, facts.height)
        camera.params = lens[_ORDER[: len(camera.params)]]
        reconstruction.add_camera(camera)
        if index:
            colmap_rig.add_sensor(camera.sensor_id, pycolmap.Rigid3d(rig.cameras[index, :3]))
        else:
            colmap_rig.add_ref_sensor(camera.sensor_id)
    reconstruction.add_rig(colmap_rig)
    places, corner_of = np.unique(seen.places, axis=0, return_inverse=True)
    tracks = [pycolmap.Track() for _ in places]
    images: dict[int, list[Any]] = {}
    order = np.lexsort((seen.cameras, seen.frames))
    views = np.column_stack([seen.frames, seen.cameras])[order]
    for rows in np.split(order, np.flatnonzero(np.any(np.diff(views, axis=0), axis=1)) + 1):
        frame, index = int(seen.frames[rows[0]]), int(seen.cameras[rows[0]])
        number = 1 + frame * len(rig.facts) + index
        image = pycolmap.Image(f"{number:08d}", keypoints=seen.pixels[rows], camera_id=index + 1, image_id=number)
        image.frame_id = frame + 1
        images.setdefault(frame, []).append(image)
        config.add_image(number)
        for row, corner in enumerate(corner_of.reshape(-1)[rows].tolist()):
            tracks[corner].add_element(number, row)
    for frame, own in images.items():
        posed = pycolmap.Frame(frame_id=frame + 1, rig_id=1, rig_from_world=pycolmap.Rigid3d(rig.boards[frame, :3]))
        for image in own:
            posed.add_data_id(image.data_id)
        reconstruction.add_frame(posed)
        for image in own:
            reconstruction.add_image(image)
    for place, track in zip(places, tracks, strict=True):
        reconstruction.add_point3D(place, track)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = options.refine_points3D = False
    options.refine_sensor_from_rig = free.poses
    options.refine_focal_length = options.refine_extra_params = bool(free.coefficients)
    options.refine_principal_point = free.centers
    options.ceres.solver_options.max_num_iterations = _ITERATIONS
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss
    return reconstruction, pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
