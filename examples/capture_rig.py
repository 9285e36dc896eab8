"""The cameras of the rendered captures: one rig of 12, exact, in bpy and in the LLFF file. World: metres, z up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from mathutils.bvhtree import BVHTree

# Azimuth and elevation in degrees, seen from the target. cam00, the test view, lies in the middle of the others.
DIRECTIONS = (
    (0.0, 5.0),
    *((azimuth, 5.0) for azimuth in (-22.0, -11.0, 11.0, 22.0)),
    *((azimuth, 13.0) for azimuth in (-17.0, -6.0, 6.0, 17.0)),
    *((azimuth, -3.0) for azimuth in (-12.0, 0.0, 12.0)),
)


@dataclass(frozen=True, eq=False)
class View:
    """One pinhole camera; square pixels, the principal point in the middle.

    Attributes:
        width, height, focal: pixels.
        matrix: (4, 4) camera-to-world in metres; its columns are right, up, backwards and the centre.
    """

    name: str
    width: int
    height: int
    focal: float
    matrix: np.ndarray

    @property
    def center(self) -> np.ndarray:
        return self.matrix[:3, 3]

    def add_camera(self) -> bpy.types.Object:
        """The camera in bpy, of the same name."""
        lens = bpy.data.cameras.new(self.name)
        lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", 36.0, self.focal * 36.0 / self.width
        lens.clip_start, lens.clip_end = 0.05, 50.0
        camera = bpy.data.objects.new(lens.name, lens)
        camera.matrix_world = Matrix(self.matrix.tolist())
        bpy.context.scene.collection.objects.link(camera)
        return camera

    def rays(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """World directions (..., 3) through pixel positions (...), as long as a planar depth of 1."""
        local = np.stack([(x - self.width / 2) / self.focal, (self.height / 2 - y) / self.focal, -np.ones(x.shape)], -1)
        return local @ self.matrix[:3, :3].T

    def shows(self, points: np.ndarray) -> np.ndarray:
        """Whether (N,) world points (N, 3) lie within the image, behind other things or not."""
        x, y, z = ((points - self.center) @ self.matrix[:3, :3]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = (abs(x / z) * 2 * self.focal < self.width) & (abs(y / z) * 2 * self.focal < self.height)
        return inside & (z < 0)


class Surfaces:
    """What can be seen of bpy's scene as it is now, for rays to hit."""

    def __init__(self) -> None:
        vertices, triangles, count = [], [], 0
        for instance in bpy.context.evaluated_depsgraph_get().object_instances:
            if instance.object.type == "MESH":
                mesh = instance.object.data
                mesh.calc_loop_triangles()
                local = np.empty(3 * len(mesh.vertices), np.float32)
                corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
                mesh.vertices.foreach_get("co", local)
                mesh.loop_triangles.foreach_get("vertices", corners)
                turn = np.array(instance.matrix_world)
                vertices += (local.reshape(-1, 3) @ turn[:3, :3].T + turn[:3, 3]).tolist()
                triangles += (corners.reshape(-1, 3) + count).tolist()
                count = len(vertices)
        self._tree = BVHTree.FromPolygons(vertices, triangles, all_triangles=True)

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """How far (N,) rays (N, 3) from a point go, in lengths of theirs; infinitely where they hit nothing."""
        hits = [self._tree.ray_cast(origin.tolist(), ray)[3] for ray in rays.tolist()]
        return np.array([np.inf if hit is None else hit for hit in hits]) / np.linalg.norm(rays, axis=1)


@dataclass(frozen=True)
class Rig:
    """Cameras that look at `target` from `directions`."""

    width: int
    height: int
    focal: float  # pixels
    target: tuple[float, float, float] = (0.12, 0.1, 1.10)
    distance: float = 4.4
    directions: tuple[tuple[float, float], ...] = DIRECTIONS

    @property
    def views(self) -> list[View]:
        """The cameras, in the order of their videos."""
        return [self.view_from(f"cam{index:02d}", direction) for index, direction in enumerate(self.directions)]

    def view_from(self, name: str, direction: tuple[float, float], nearer: float = 1.0, zoom: float = 1.0) -> View:
        """A camera so many times nearer to the target than the rig's, with so many times their focal length."""
        a, e = (math.radians(angle) for angle in direction)
        backwards = np.array([math.sin(a) * math.cos(e), -math.cos(a) * math.cos(e), math.sin(e)])
        right = np.cross(np.array([0.0, 0.0, 1.0]), backwards)
        right /= np.linalg.norm(right)
        center = np.array(self.target) + self.distance / nearer * backwards
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, np.cross(backwards, right), backwards, center], axis=1)
        return View(name, self.width, self.height, zoom * self.focal, matrix)

    def measure_depths(self, step: int = 8) -> list[tuple[float, float]]:
        """Least and greatest planar depth in metres that each camera sees now, over a grid of pixels."""
        surfaces, bounds = Surfaces(), []
        for view in self.views:
            x, y = np.meshgrid(np.arange(0.0, self.width + 1, step), np.arange(0.0, self.height + 1, step))
            depths = surfaces.distances(view.center, view.rays(x.ravel(), y.ravel()))
            bounds.append((depths.min(), depths[np.isfinite(depths)].max()))
        return bounds

    def write_poses(self, path: Path, bounds: np.ndarray) -> None:
        """The LLFF camera file, (cameras, 17) float64: axes (down, right, back), centre, size, focal, near, far."""
        rows = []
        for view, (near, far) in zip(self.views, bounds, strict=True):
            right, up, backwards, center = view.matrix[:3].T
            size = np.array([self.height, self.width, self.focal])
            matrix = np.stack([-up, right, backwards, center, size], axis=1)
            rows.append(np.concatenate([matrix.ravel(), [near, far]]))
        np.save(path, np.array(rows, dtype=np.float64))
