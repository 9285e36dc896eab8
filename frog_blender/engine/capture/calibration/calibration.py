"""What a calibration finds, as it goes from the child to its caller."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...arrays import Float64s
from ..camera import Camera
from ..synchronization.motion import Cameras
from .model import Lens


@dataclass(frozen=True)
class CameraSupport:
    """What supports one camera.

    Attributes:
        observations: that agree with the model.
        share: of its observations that agree.
        shared_by_three: points that it sees together with two others at once.
        residual: median, pixels.
        coverage: share of 8 x 6 cells of its image that hold an observation.
        focal_uncertainty: standard deviation of the focal length over the focal length.
    """

    observations: int
    share: float
    shared_by_three: int
    residual: float
    coverage: float
    focal_uncertainty: float


@dataclass(frozen=True)
class PairSupport:
    """Two cameras by index: their matches, those that pass the two-view check, and those that agree with the model."""

    one: int
    other: int
    matches: int
    verified: int
    agreeing: int


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """One camera and what supports it.

    Attributes:
        camera: without its distortion; the principal point in the middle.
        distortion: k1 and k2 in OpenCV's order.
        support: what speaks for it.
        observations: (N, 3) some of its observations: x and y in pixels, and 1 for those that agree with the rest.
    """

    camera: Camera
    distortion: tuple[float, float]
    support: CameraSupport
    observations: Float64s


@dataclass(frozen=True, eq=False)
class Calibration:
    """The cameras of a rig. World: z up, y ahead, the origin where the cameras look; the scale is free.

    Attributes:
        cameras: in the order of the views.
        points: (N, 3) float64 points on surfaces.
        pairs: what connects the cameras, by their indices.
        halves_apart: how far cameras lie apart when half of the points are used each, over the rig's diameter; NaN
            where nothing compared them.
        warnings: one sentence each.
        is_metric: the scale is not free: lengths are metres.
        source: what the cameras come from.
    """

    cameras: tuple[CalibratedCamera, ...]
    points: Float64s = field(default_factory=lambda: np.empty((0, 3)))
    pairs: tuple[PairSupport, ...] = ()
    halves_apart: float = np.nan
    warnings: tuple[str, ...] = ()
    is_metric: bool = False
    source: str = "features"

    @property
    def known(self) -> Cameras:
        """The cameras for synchronisation."""
        return {known.camera.name: (known.camera, np.array([*known.distortion, 0.0, 0.0])) for known in self.cameras}


@dataclass(frozen=True, eq=False)
class MovingCamera:
    """The posed images of a camera that moves.

    Attributes:
        lens: of the camera.
        placed: the images that have a pose, by their index among all.
        poses: (images, 3, 4) world to camera, of those.
        points: (N, 3) on surfaces.
        residual: median, pixels.
        focal_uncertainty: standard deviation of the focal length over the focal length, the largest.
        halves_apart: as of ``Calibration``, over the path's size.
        warnings: one sentence each.
    """

    lens: Lens
    placed: tuple[int, ...]
    poses: Float64s
    points: Float64s
    residual: float
    focal_uncertainty: float
    halves_apart: float
    warnings: tuple[str, ...] = ()
