"""What calibration hands on: the cameras of a rig, or a refusal that says what to film next time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Float64s, Ints
from ...errors import FrogError
from ..camera import Camera
from .rig_solver import CENTER_X, CENTER_Y, FOCAL, K1, K2, Rig, Sightings, Solution


class CalibrationRefused(FrogError):
    """The footage does not say where the cameras stood; the message says why, and what to film next time."""


@dataclass(frozen=True, eq=False)
class CameraFacts:
    """What is known of a camera before its calibration: its name, and its size in pixels."""

    name: str
    width: int
    height: int

    @property
    def side(self) -> int:
        """Pixels of the longer side."""
        return max(self.width, self.height)


@dataclass(frozen=True, eq=False)
class FoundRig:
    """Cameras as calibration found them, in the order in which they were given.

    Attributes:
        cameras: the pinhole part, pixel centres at +0.5.
        radial: (C, 2) k1 and k2 as of OpenCV.
        residuals: (C,) median distance in pixels of the sightings that were used from where they project.
        counts: (C,) sightings used.
        focal_sigmas: (C,) standard deviation of the focal length, relative.
        is_metric: lengths are metres; otherwise their unit is arbitrary.
        points: (N, 3) places in the world that were seen.
        warnings: sentences for the person.
    """

    cameras: tuple[Camera, ...]
    radial: Float64s
    residuals: Float64s
    counts: Ints
    focal_sigmas: Float64s
    is_metric: bool
    points: Float64s
    warnings: tuple[str, ...] = ()


def found_rig(
    facts: Sequence[CameraFacts], solution: Solution, used: Sightings, *, is_metric: bool, warnings: Sequence[str] = ()
) -> FoundRig:
    """The result of a solution; ``used`` are the sightings that it stands on."""
    rig = solution.rig
    off = np.linalg.norm(rig.residuals(used), axis=1)
    rows = [used.cameras == camera for camera in range(len(facts))]
    world = np.einsum("mij,mj->mi", rig.body_rotations[used.bodies], used.places) + rig.body_positions[used.bodies]
    lenses = rig.lenses[rig.lens_of]
    return FoundRig(
        cameras=tuple(_camera(camera, rig, index) for index, camera in enumerate(facts)),
        radial=lenses[:, [K1, K2]],
        residuals=np.array([np.median(off[row]) if row.any() else np.nan for row in rows]),
        counts=np.array([row.sum() for row in rows]),
        focal_sigmas=solution.lens_sigmas[rig.lens_of, FOCAL],
        is_metric=is_metric,
        points=np.unique(world, axis=0),
        warnings=tuple(warnings),
    )


def _camera(facts: CameraFacts, rig: Rig, index: int) -> Camera:
    lens = rig.lenses[rig.lens_of[index]]
    focal, x, y = lens[[FOCAL, CENTER_X, CENTER_Y]].tolist()
    intrinsics = np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rig.rotations[index], rig.translations[index]
    return Camera(facts.name, facts.width, facts.height, intrinsics, pose)
