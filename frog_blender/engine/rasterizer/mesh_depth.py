"""How far away the surfaces of a mesh are, pixel by pixel: the depth limit that hides Gaussians behind objects."""

from ctypes import byref, c_int32

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..native import structs
from ..native.binding import check_status, library
from ..native.options import RasterizeOptions


def mesh_depth(vertices: Array, triangles: Array, camera: Camera, options: RasterizeOptions | None = None) -> Array:
    """(H, W) float32 planar depth of the nearest triangle along each pixel's central ray, infinity where there is none.

    Args:
        vertices: (V, 3), world units.
        triangles: (T, 3) indices of vertices; both sides count. One with a missing or non-finite vertex is left out.
        options: of the drawing that this limits: its region, and its near plane, before which triangles are cut off.

    Raises:
        ValueError: for arrays of other shapes.
        MemoryError: when memory runs out.
    """
    vertices = np.ascontiguousarray(vertices, np.float32)
    triangles = np.ascontiguousarray(triangles, np.int32)
    for name, array in (("vertices", vertices), ("triangles", triangles)):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name}: shape {array.shape}, expected (number, 3)")
    options = options or RasterizeOptions()
    region = options.region_of(camera)
    depth = np.empty((region[3], region[2]), np.float32)
    mesh = vertices.ctypes.data, len(vertices), triangles.ctypes.data, len(triangles)
    view = byref(structs.camera_struct(camera)), byref((c_int32 * 4)(*region)), options.near_plane
    status = library().frog_mesh_depth(*mesh, *view, depth.ctypes.data)
    check_status(status, "the depth of the scene's objects")
    return depth
