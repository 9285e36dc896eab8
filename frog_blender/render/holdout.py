"""Objects that occlude Gaussians: the FROG engine stops blending at the depth of a scene's surfaces.

Each splat ends at the surface, so half-transparent ones before and behind an object are both right; an image made so
goes over the objects' own by plain alpha (see operators/compose.py). A pixel that an object's edge crosses is drawn
twice, up to what lies in front and up to what lies behind, and mixed by how much of it the object covers.
"""

from dataclasses import dataclass, replace
from functools import reduce

import bpy
import numpy as np

from .. import point_cloud, reported_once
from ..capture_files import is_capture
from ..engine.capture.camera import Camera
from ..engine.gaussians import GaussianArrays
from ..engine.native.options import RasterizeOptions
from ..engine.playback.render import Drawing, draw
from ..engine.rasterizer.mesh_depth import mesh_depth
from ..scene_import.scene_setup import start_cube
from .collect_instances import is_seen

_SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
_ACROSS = 4  # depths along each side of a pixel
MOST_DEPTHS = 40_000_000  # at once, in a band of rows: 160 MB
_STEP = 1.02  # depths of one pixel that differ by more are of two surfaces


@dataclass(frozen=True)
class Limits:
    """Depth limits of splats.

    Attributes:
        front, behind: (H, W) planar depth of the nearest surface, and of what shows beside it where its edge crosses a
            pixel; infinity where there is none. Equal in all other pixels.
        share: (H, W) of each pixel that ``front`` covers.
    """

    front: np.ndarray
    behind: np.ndarray
    share: np.ndarray


def draw_before(limits: Limits, gaussians: GaussianArrays, camera: Camera, options: RasterizeOptions) -> Drawing:
    """Draws Gaussians that end at these limits."""
    drawing = draw(gaussians, camera, options=options, depth_limit=limits.front)
    rows, columns = np.nonzero(limits.share < 1)
    if not rows.size:
        return drawing
    box = slice(int(rows.min()), int(rows.max()) + 1), slice(int(columns.min()), int(columns.max()) + 1)
    left, top, *_ = options.region_of(camera)
    part = limits.behind[box]
    region = (left + box[1].start, top + box[0].start, part.shape[1], part.shape[0])
    behind = draw(gaussians, camera, options=replace(options, region=region), depth_limit=part)
    rest = 1 - limits.share[box]
    drawing.rgb[box] += (behind.rgb - drawing.rgb[box]) * rest[..., None]
    drawing.alpha[box] += (behind.alpha - drawing.alpha[box]) * rest
    for name in ("median_depth", "median_z", "mean_depth", "median_index"):  # depths must not be averaged
        np.copyto(getattr(drawing, name)[box], getattr(behind, name), where=rest > 0.5)
    return drawing


def limits_of_mesh(vertices: np.ndarray, triangles: np.ndarray, camera: Camera, options: RasterizeOptions) -> Limits:
    """Depth limits at a mesh of (V, 3) world-space vertices and (T, 3) triangles."""
    vertices, triangles = np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.int32)
    finer = camera.resized(camera.width * _ACROSS, camera.height * _ACROSS)
    left, top, width, height = options.region_of(camera)
    rows = max(1, MOST_DEPTHS // (_ACROSS**2 * width))
    bands = []
    for first in range(top, top + height, rows):
        count = min(rows, top + height - first)
        region = (_ACROSS * left, _ACROSS * first, _ACROSS * width, _ACROSS * count)
        depths = mesh_depth(vertices, triangles, finer, replace(options, region=region))
        bands.append(_split_surfaces(depths.reshape(count, _ACROSS, width, _ACROSS)))
    return Limits(*(np.concatenate(parts) for parts in zip(*bands, strict=True)))


def _split_surfaces(depths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Front, behind and share (see Limits) of (H, n, W, n) depths within pixels."""
    nearest, furthest = _over_pixels(np.minimum, depths), _over_pixels(np.maximum, depths)
    with np.errstate(invalid="ignore"):
        front = np.where(np.isfinite(furthest), 0.5 * (nearest + furthest), nearest)
    behind, share = front.copy(), np.ones_like(front)
    edges = np.nonzero(furthest > _STEP * nearest)
    # By inverse depth, which is zero at infinity, so that distant steps count less.
    inverse = 1 / np.sort(depths.transpose(0, 2, 1, 3)[edges].reshape(len(edges[0]), _ACROSS**2), axis=1)
    count = (inverse[:, :-1] - inverse[:, 1:]).argmax(1) + 1  # of depths that are of the surface in front
    in_front = np.arange(inverse.shape[1]) < count[:, None]
    with np.errstate(divide="ignore"):
        front[edges] = count / np.where(in_front, inverse, 0).sum(1)
        behind[edges] = (inverse.shape[1] - count) / np.where(in_front, 0, inverse).sum(1)
    share[edges] = count / inverse.shape[1]
    return front, behind, share


def _over_pixels(keep: np.ufunc, depths: np.ndarray) -> np.ndarray:
    """Reduces (H, n, W, n) to (H, W), ten times as fast as numpy over both axes at once."""
    rows = keep.reduce(depths, axis=1)
    return reduce(keep, (rows[..., i] for i in range(_ACROSS)))


def mesh_of(
    depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None = None, most: int | None = None
) -> tuple[np.ndarray, np.ndarray] | None:
    """(V, 3) vertices in world space and (T, 3) triangles of everything that the camera can see, instances included;
    None without any.

    Args:
        space: the 3D viewport that is drawn, in which the cube of a new file hides nothing; None for a render.
        most: triangles, beyond which objects are left out.
    """
    of_instances: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    count = room = 0
    cube = start_cube(depsgraph.scene.original) if space is not None else None
    for instance in depsgraph.object_instances:
        obj = instance.object
        if obj.type not in _SURFACES or is_capture(obj.original) or obj.is_shadow_catcher or obj.original == cube:
            continue
        # A proxy is the splats themselves, coarsely.
        if obj.original.frog.is_proxy or not is_seen(instance, depsgraph.view_layer, space):
            continue
        if not instance.is_instance:
            points, corners = _mesh_of(obj)
        else:  # converted once for all of them; the evaluated data alone would not tell how a curve is filled
            key = obj.original.as_pointer(), obj.data.as_pointer()
            if key not in of_instances:
                of_instances[key] = _mesh_of(obj)
            points, corners = of_instances[key]
        if not corners.size:
            continue
        if most is not None and (room := room + len(corners)) > most:
            reported_once.message(
                f"Objects beyond {most:,} triangles hide no splats here. Show the viewport's overlays."
            )
            break
        matrix = np.array(instance.matrix_world)
        vertices.append((points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32))
        triangles.append(corners + count)
        count += len(points)
    return (np.concatenate(vertices), np.concatenate(triangles)) if count else None


def _mesh_of(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an evaluated object in its own space."""
    mesh = obj.to_mesh()
    if mesh is None:
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.int32)
    arrays = point_cloud.triangles_of(mesh)
    obj.to_mesh_clear()
    return arrays
