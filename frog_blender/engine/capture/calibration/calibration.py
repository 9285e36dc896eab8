"""What a calibration finds, as it goes from the child to its caller, and the refusal where footage does not fix it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError
from ...io.child_process import Task
from ...io.plain_values import JsonObject
from ..camera import Camera


class CalibrationRefused(FrogError):
    """The footage does not fix its cameras; the sentence says why, and what to film next time."""


def child_task(function: str) -> Task:
    """What is left to a process of its own, which pycolmap or a matrix library may end: a module and its function."""
    return Task(f"capture.calibration.{function}", _failure, CalibrationRefused)


def _failure(end: str) -> str:
    return f"The calibration's process {end}; nothing was written, and what is done is kept."


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
        closing: share of its triangles of cameras whose rotations close; NaN without triangles.
    """

    observations: int
    share: float
    shared_by_three: int
    residual: float
    coverage: float
    focal_uncertainty: float
    closing: float = float("nan")


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
        pairs: what connects the cameras, by their places.
        start: focal length over the width that the search started from.
        own_focals: cameras of equal size have focal lengths of their own.
        costs: of all starts that found a model.
        halves_apart: how far cameras lie apart when half of the points are used each, over the rig's diameter; NaN
            where nothing compared them.
        warnings: one sentence each.
        is_metric: the scale is not free: lengths are metres.
        source: what the cameras come from.
    """

    cameras: tuple[CalibratedCamera, ...]
    points: Float64s = field(default_factory=lambda: np.empty((0, 3)))
    pairs: tuple[PairSupport, ...] = ()
    start: float = 0.0
    own_focals: bool = False
    costs: tuple[float, ...] = ()
    halves_apart: float = 0.0
    warnings: tuple[str, ...] = ()
    is_metric: bool = False
    source: str = "features"

    def plain(self) -> JsonObject:
        """As plain values, without what the caller adds; ``of_plain`` reads them back."""
        cameras = [
            {
                "name": found.camera.name,
                "size": [found.camera.width, found.camera.height],
                "intrinsics": found.camera.intrinsics.tolist(),
                "pose": found.camera.world_to_camera.tolist(),
                "distortion": list(found.distortion),
                "support": asdict(found.support),
                "observations": found.observations.round(1).tolist(),
            }
            for found in self.cameras
        ]
        return {
            "cameras": cameras,
            "points": self.points.round(5).tolist(),
            "pairs": [asdict(pair) for pair in self.pairs],
            "start": self.start,
            "own_focals": self.own_focals,
            "costs": list(self.costs),
            "halves_apart": self.halves_apart,
            "warnings": list(self.warnings),
            "is_metric": self.is_metric,
        }

    @classmethod
    def of_plain(cls, plain: JsonObject) -> Calibration:
        """The calibration of plain values; KeyError, TypeError or ValueError where they are damaged."""
        cameras = [
            CalibratedCamera(
                Camera(
                    str(entry["name"]),
                    int(entry["size"][0]),
                    int(entry["size"][1]),
                    np.asarray(entry["intrinsics"], np.float64),
                    np.asarray(entry["pose"], np.float64),
                ),
                (float(entry["distortion"][0]), float(entry["distortion"][1])),
                CameraSupport(**entry["support"]),
                np.asarray(entry["observations"], np.float64).reshape(-1, 3),
            )
            for entry in plain["cameras"]
        ]
        return cls(
            tuple(cameras),
            np.asarray(plain["points"], np.float64).reshape(-1, 3),
            tuple(PairSupport(**entry) for entry in plain["pairs"]),
            float(plain["start"]),
            bool(plain["own_focals"]),
            tuple(float(cost) for cost in plain["costs"]),
            float(plain["halves_apart"]),
            tuple(str(warning) for warning in plain["warnings"]),
            bool(plain["is_metric"]),
        )
