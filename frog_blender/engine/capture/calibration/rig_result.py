"""A solved rig as a ``Calibration``: in the world that ``orientation`` chooses, with what supports each camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..camera import Camera
from .calibration import CalibratedCamera, Calibration
from .evidence import CameraEvidence
from .lens import Lens
from .mapping import Model
from .rig_solver import CENTER_X, CENTER_Y, FOCAL, K1, K2, Rig, Sightings, Solution
from .rig_world import oriented

_CELLS = np.array([8, 6])  # of an image, in which sightings are counted
_SHOWN = 400  # sightings of a camera, for the report


@dataclass(frozen=True)
class CameraFacts:
    """What is known of a camera before its calibration: its name, and its size in pixels."""

    name: str
    width: int
    height: int

    @property
    def side(self) -> int:
        """Pixels of the longer side."""
        return max(self.width, self.height)


def calibration_of(
    facts: Sequence[CameraFacts], solution: Solution, sightings: Sightings, agrees: Bools, *, is_metric: bool = False
) -> Calibration:
    """The result of a solution.

    Args:
        facts: of the cameras.
        sightings: all that the solution knew.
        agrees: (M,) which of them lie near enough to where the rig puts them.
        is_metric: lengths are metres, and stay so; otherwise the world's scale is chosen.
    """
    rig = solution.rig
    world = np.einsum("mij,mj->mi", rig.body_rotations[sightings.bodies], sightings.places)
    world += rig.body_positions[sightings.bodies]
    names = np.column_stack([sightings.bodies, sightings.places])
    _, first, point_of = np.unique(names, axis=0, return_index=True, return_inverse=True)
    poses, points = _in_the_world(facts, rig, world[first], is_metric=is_metric)
    evidence = _evidence(facts, solution, sightings, agrees, point_of.reshape(-1))
    shown = np.bincount(point_of.reshape(-1)[agrees], minlength=len(points)) >= 2
    cameras = []
    for index, (camera, pose) in enumerate(zip(facts, poses, strict=True)):
        lens = rig.lenses[rig.lens_of[index]]
        rows = np.flatnonzero(sightings.cameras == index)
        rows = rows[:: max(1, len(rows) // _SHOWN)]
        cameras.append(
            CalibratedCamera(
                _camera(camera, lens, pose),
                (float(lens[K1]), float(lens[K2])),
                evidence[index],
                np.column_stack([sightings.pixels[rows], agrees[rows]]).astype(np.float64),
            )
        )
    return Calibration(tuple(cameras), points[shown], is_metric=is_metric)


def _in_the_world(
    facts: Sequence[CameraFacts], rig: Rig, points: Float64s, *, is_metric: bool
) -> tuple[Float64s, Float64s]:
    """(C, 3, 4) poses and (N, 3) points where z is up."""
    focals = rig.lenses[rig.lens_of, FOCAL].tolist()
    lenses = tuple(Lens(each.width, each.height, focal) for each, focal in zip(facts, focals, strict=True))
    poses = np.concatenate([rig.rotations, rig.translations[:, :, None]], axis=2)
    model, placed = oriented(Model(poses, lenses), points)
    turned: Float64s = model.poses
    if is_metric and len(points) > 1:
        scale = float(np.linalg.norm(points - points.mean(0)) / np.linalg.norm(placed - placed.mean(0)))
        turned[:, :, 3] *= scale
        placed = placed * scale
    return turned, placed


def _evidence(
    facts: Sequence[CameraFacts], solution: Solution, sightings: Sightings, agrees: Bools, point_of: Ints
) -> list[CameraEvidence]:
    off = np.linalg.norm(solution.rig.residuals(sightings), axis=1)
    lengths = np.bincount(point_of[agrees], minlength=int(point_of.max()) + 1)
    sigmas = solution.lens_sigmas[solution.rig.lens_of, FOCAL]
    found = []
    for index, camera in enumerate(facts):
        own = sightings.cameras == index
        good = own & agrees
        cells = (sightings.pixels[good] / (camera.width, camera.height) * _CELLS).astype(int).clip(0, _CELLS - 1)
        found.append(
            CameraEvidence(
                observations=int(good.sum()),
                share=float(good.sum() / max(own.sum(), 1)),
                shared_by_three=int((lengths[point_of[good]] >= 3).sum()),
                residual=float(np.median(off[good])) if good.any() else float("inf"),
                coverage=len(np.unique(cells, axis=0)) / float(_CELLS.prod()),
                focal_uncertainty=float(sigmas[index]),
                closing=float("nan"),
            )
        )
    return found


def _camera(facts: CameraFacts, lens: Float64s, pose: Float64s) -> Camera:
    focal, x, y = lens[[FOCAL, CENTER_X, CENTER_Y]].tolist()
    intrinsics = np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
    return Camera(facts.name, facts.width, facts.height, intrinsics, np.vstack([pose, [[0.0, 0.0, 0.0, 1.0]]]))
