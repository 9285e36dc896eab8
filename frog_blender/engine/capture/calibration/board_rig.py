"""A board that moves before standing cameras, adjusted by COLMAP: seen from the board, they are a rig that moves.

The board's corners stay where they are, each common time is a pose of the rig, and the cameras stand within it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Bools, Float64s, Ints
from .colmap import MODELS, colmap_camera, load_pycolmap
from .model import Lens
from .views import CameraFacts

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
        lenses: (C, 3) focal length in pixels, k1 and k2; the principal point lies in the middle.
        cameras: (C, 4, 4) world to camera; the first one's axes are the world's.
        boards: (F, 4, 4) board to world at each common time.
    """

    facts: tuple[CameraFacts, ...]
    lenses: Float64s
    cameras: Float64s
    boards: Float64s

    def distances(self, seen: Corners3D) -> Float64s:
        """(M,) pixels between where corners were seen and where the rig puts them; many behind a camera."""
        poses = self.cameras[seen.cameras] @ self.boards[seen.frames]
        local = np.einsum("mij,mj->mi", poses[:, :3, :3], seen.places) + poses[:, :3, 3]
        focal, k1, k2 = self.lenses[seen.cameras].T
        is_behind = local[:, 2] < _NEAREST
        flat = local[:, :2] / np.where(is_behind, 1.0, local[:, 2])[:, None]
        square = (flat**2).sum(axis=1)
        middles = np.array([facts.size for facts in self.facts])[seen.cameras] / 2
        bent = (focal * (1.0 + square * (k1 + square * k2)))[:, None] * flat
        return np.where(is_behind, _BEHIND, np.linalg.norm(bent + middles - seen.pixels, axis=1))


def adjust_rig(
    rig: BoardRig, seen: Corners3D, coefficients: tuple[int, ...], loss: float, *, poses: bool = True
) -> BoardRig:
    """The rig that explains the corners best, from a start near it; frames without a corner stay.

    Args:
        coefficients: for each camera how many of k1 and k2 are free beside its focal length; none: no lens is.
        loss: Cauchy's scale in pixels.
        poses: the cameras' are free.
    """
    pycolmap = load_pycolmap()
    reconstruction, config = _reconstruction(rig, seen, coefficients)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = options.refine_points3D = False
    options.refine_sensor_from_rig = poses
    options.refine_focal_length = options.refine_extra_params = bool(coefficients)
    options.ceres.solver_options.max_num_iterations = _ITERATIONS
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss
    pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction).solve()
    lenses, cameras, boards = rig.lenses.copy(), rig.cameras.copy(), rig.boards.copy()
    for index in range(len(rig.facts)):
        camera = reconstruction.camera(index + 1)
        lenses[index, [0, *range(1, len(camera.params) - 2)]] = camera.params[[0, *range(3, len(camera.params))]]
        if index:
            cameras[index, :3] = reconstruction.rig(1).sensor_from_rig(camera.sensor_id).matrix()
    for number in reconstruction.frames:
        boards[number - 1, :3] = reconstruction.frame(number).rig_from_world.matrix()
    return replace(rig, lenses=lenses, cameras=cameras, boards=boards)


def _reconstruction(rig: BoardRig, seen: Corners3D, coefficients: tuple[int, ...]) -> tuple[Any, Any]:
    """pycolmap's, with its adjustment's configuration: an image for each camera and time that shows the board."""
    pycolmap = load_pycolmap()
    reconstruction, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
    colmap_rig = pycolmap.Rig(rig_id=1)
    for index, facts in enumerate(rig.facts):
        model = MODELS[coefficients[index] if coefficients else -1]
        camera = colmap_camera(Lens(*facts.size, *rig.lenses[index].tolist()), index + 1, model)
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
    return reconstruction, config
