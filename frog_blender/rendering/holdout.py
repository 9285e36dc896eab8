"""Objects that hide Gaussians: the depth of a Blender scene's surfaces, for the FROG engine to stop at while it blends.

Each splat ends at the surface, so half-transparent ones before and behind an object are both right; a picture made so
goes over the objects' own by plain alpha (see operators/compose.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..engine.capture.camera import Camera
    from ..engine.rasterizer.options import RasterizeOptions

_SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}


def depth_of_objects(depsgraph: Any, camera: Camera, options: RasterizeOptions) -> np.ndarray | None:
    """(H, W) planar depth of the nearest surface of any object that is no capture, infinity where there is none; None
    without such objects."""
    from ..engine.rasterizer.mesh_depth import mesh_depth

    vertices, triangles, count = [], [], 0
    for points, corners in _surfaces(depsgraph):
        vertices.append(points)
        triangles.append(corners + count)
        count += len(points)
    if not count:
        return None
    return mesh_depth(np.concatenate(vertices), np.concatenate(triangles), camera, options)


def _surfaces(depsgraph: Any) -> Any:
    """World-space vertices (V, 3) and triangles (T, 3) of everything that the camera can see, instances included."""
    for instance in depsgraph.object_instances:
        obj = instance.object
        if obj.type not in _SURFACES or obj.original.frog.filepath or not obj.visible_camera or not instance.show_self:
            continue
        mesh = obj.to_mesh()
        if mesh is None:
            continue
        mesh.calc_loop_triangles()
        points = np.empty(3 * len(mesh.vertices), np.float32)
        corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.vertices.foreach_get("co", points)
        mesh.loop_triangles.foreach_get("vertices", corners)
        obj.to_mesh_clear()
        if corners.size:
            matrix = np.array(instance.matrix_world)
            yield points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3], corners.reshape(-1, 3)
