"""The cameras of the rendered captures: one rig of 12, exact, in bpy and in the LLFF file. World: metres, z up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

# Azimuth and elevation in degrees, seen from the target. cam00, the test view, lies in the middle of the others.
DIRECTIONS = (
    (0.0, 5.0),
    *((azimuth, 5.0) for azimuth in (-22.0, -11.0, 11.0, 22.0)),
    *((azimuth, 13.0) for azimuth in (-17.0, -6.0, 6.0, 17.0)),
    *((azimuth, -3.0) for azimuth in (-12.0, 0.0, 12.0)),
)


@dataclass(frozen=True)
class Rig:
    """Pinhole cameras that look at `target` from `directions`; square pixels, the principal point in the middle."""

    width: int
    height: int
    focal: float  # pixels
    target: tuple[float, float, float] = (0.12, 0.1, 1.10)
    distance: float = 4.4
    directions: tuple[tuple[float, float], ...] = DIRECTIONS

    def __len__(self) -> int:
        return len(self.directions)

    def axes(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """World centre and the unit axes right, up, backwards of camera `index`."""
        a, e = (math.radians(angle) for angle in self.directions[index])
        backwards = np.array([math.sin(a) * math.cos(e), -math.cos(a) * math.cos(e), math.sin(e)])
        right = np.cross(np.array([0.0, 0.0, 1.0]), backwards)
        right /= np.linalg.norm(right)
        return np.array(self.target) + self.distance * backwards, right, np.cross(backwards, right), backwards

    def add_cameras(self) -> list[bpy.types.Object]:
        """The cameras in bpy, in the order of their videos."""
        cameras = []
        for index in range(len(self)):
            center, right, up, backwards = self.axes(index)
            lens = bpy.data.cameras.new(f"cam{index:02d}")
            lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", 36.0, self.focal * 36.0 / self.width
            lens.clip_start, lens.clip_end = 0.05, 50.0
            camera = bpy.data.objects.new(lens.name, lens)
            matrix = np.eye(4)
            matrix[:3] = np.stack([right, up, backwards, center], axis=1)
            camera.matrix_world = Matrix(matrix.tolist())
            bpy.context.scene.collection.objects.link(camera)
            cameras.append(camera)
        return cameras

    def measure_depths(self, index: int, step: int = 8) -> tuple[float, float]:
        """Least and greatest planar depth in metres that camera `index` sees now, over a grid of pixels."""
        center, right, up, backwards = self.axes(index)
        graph = bpy.context.evaluated_depsgraph_get()
        depths = []
        for y in range(0, self.height + 1, step):
            for x in range(0, self.width + 1, step):
                ray = right * (x - self.width / 2) / self.focal - up * (y - self.height / 2) / self.focal - backwards
                ray /= np.linalg.norm(ray)
                hit, place, *_ = bpy.context.scene.ray_cast(graph, Vector(center), Vector(ray))
                if hit:
                    depths.append(float((center - np.array(place)) @ backwards))
        return min(depths), max(depths)

    def write_poses(self, path: Path, bounds: np.ndarray) -> None:
        """The LLFF camera file, (cameras, 17) float64: axes (down, right, back), centre, size, focal, near, far."""
        rows = []
        for index, (near, far) in enumerate(bounds):
            center, right, up, backwards = self.axes(index)
            size = np.array([self.height, self.width, self.focal])
            matrix = np.stack([-up, right, backwards, center, size], axis=1)
            rows.append(np.concatenate([matrix.ravel(), [near, far]]))
        np.save(path, np.array(rows, dtype=np.float64))
