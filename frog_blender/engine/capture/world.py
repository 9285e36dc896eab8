"""Where a capture's coordinates lie in the world of its files: far from the origin, single precision is too coarse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Float64s
from ..io.plain_values import entries, number, numbers
from .camera import Camera

_MAX_COORDINATE = 1e12  # world units
_UNITS = 1e-12, 1e12


@dataclass(frozen=True)
class World:
    """The files' coordinates are ``origin`` + ``unit`` x the capture's.

    Attributes:
        origin: (x, y, z) in the files' units.
        unit: files' units in one of the capture's.
    """

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    @property
    def is_plain(self) -> bool:
        """The capture's coordinates are the files' own."""
        return self == World()

    def local_points(self, points: Float64s) -> Float64s:
        """(N, 3) points of the files in the capture's coordinates."""
        return np.asarray((points - np.array(self.origin)) / self.unit)

    def local_camera(self, camera: Camera) -> Camera:
        """A camera of the files in the capture's coordinates."""
        pose = camera.world_to_camera[:3].copy()
        pose[:, 3] = (pose[:, :3] @ np.array(self.origin) + pose[:, 3]) / self.unit
        return camera.with_pose(pose)

    def __str__(self) -> str:
        origin = ", ".join(f"{value:.10g}" for value in self.origin)
        return f"({origin}) + {'' if self.unit == 1 else f'{self.unit:g} x '}the scene's coordinates"

    def to_json(self) -> dict[str, object]:
        """A plain dictionary for headers; ``from_json`` reads it back."""
        return {"origin": list(self.origin), "unit": self.unit}

    @classmethod
    def from_json(cls, data: object) -> World:
        """The world of ``to_json``; UnfitValue for anything else."""
        values = {"origin": None, "unit": None} | entries(data, "world")
        x, y, z = numbers(values["origin"], "the world's origin", (3,), _MAX_COORDINATE).tolist()
        return cls((x, y, z), number(values["unit"], "the world's unit", *_UNITS))


FILES_OWN = World()
"""The world of nearly every capture: nothing is taken off."""
