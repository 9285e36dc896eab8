"""Depth images of Gaussians fused into one surface, as a mesh of quads.

Curless and Levoy, "A Volumetric Method for Building Complex Models from Range Images" (1996): on a grid, the signed
distance to the surface that each camera sees, truncated and averaged over the cameras, each weighted by how straight it
looks at the surface. The distance is to the plane that the surface is around a pixel: along its ray, a floor that is
seen from the side would be many voxels away. Space that a camera sees through counts as empty; what no camera sees into
stays unknown, and there the surface ends.

Surface nets (Gibson, "Constrained Elastic Surface Nets", 1998), without relaxation: one vertex for each cell that the
surface passes, at the mean of where it crosses the cell's edges.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import NumpyGaussians
from ..graphs import components
from ..playback.render import draw
from ..playback.transform import rotations_of


@dataclass(frozen=True)
class Mesh:
    """A mesh of quads.

    Attributes:
        vertices: (V, 3) float32, world units.
        quads: (F, 4) int32 indices of vertices, counter-clockwise from outside.
    """

    vertices: Array
    quads: Array


NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.int32))
_CORNERS = np.array(list(product((0, 1), repeat=3)))
_EDGES = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1])


def surface_nets(field: Array) -> Mesh:
    """The zero surface of a field, in units of the grid.

    Args:
        field: (X, Y, Z) values at grid points (x, y, z): positive outside, NaN where nothing is known. There the
            surface has an edge.
    """
    least, largest = (_over_corners(combine, field) for combine in (np.minimum, np.maximum))  # NaN where one is
    cells = np.argwhere((least < 0) & (largest >= 0))
    values = np.stack([field[tuple((cells + corner).T)] for corner in _CORNERS], axis=1)
    first, second = values[:, _EDGES[:, 0]], values[:, _EDGES[:, 1]]
    crossed = (first < 0) != (second < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crossed, first / (first - second), 0.0)
    start, step = _CORNERS[_EDGES[:, 0]], _CORNERS[_EDGES[:, 1]] - _CORNERS[_EDGES[:, 0]]
    points = (start + share[..., None] * step) * crossed[..., None]
    vertices = cells + points.sum(1) / crossed.sum(1)[:, None]
    vertex_of = np.full([max(size - 1, 0) for size in field.shape], -1, np.int32)
    vertex_of[tuple(cells.T)] = np.arange(len(cells))
    quads = np.concatenate([_quads_across(field, vertex_of, axis) for axis in range(3)])
    return _used(Mesh(vertices.astype(np.float32), quads))


def without_islands(mesh: Mesh, least: int) -> Mesh:
    """A mesh without the connected parts of fewer than so many quads: what floats in the air and shadows nothing."""
    starts = np.repeat(mesh.quads[:, 0], 3)
    part = components(starts, mesh.quads[:, 1:].ravel(), len(mesh.vertices))[mesh.quads[:, 0]]
    return _used(Mesh(mesh.vertices, mesh.quads[np.bincount(part)[part] >= least]))


def _over_corners(combine: np.ufunc, values: Array) -> Array:
    """Combines the values at the eight corners of each cell."""
    for axis in range(3):
        ahead = np.moveaxis(values, axis, 0)
        values = np.moveaxis(combine(ahead[:-1], ahead[1:]), 0, axis)
    return values


def _quads_across(field: Array, vertex_of: Array, axis: int) -> Array:
    """(F, 4) the quads across crossed edges of the grid along an axis: each joins the four cells around the edge."""
    ahead = np.moveaxis(field, axis, 0)
    cell = np.moveaxis(vertex_of, axis, 0)
    with np.errstate(invalid="ignore"):
        low, high = ahead[:-1, 1:-1, 1:-1] < 0, ahead[1:, 1:-1, 1:-1] < 0
    along, across, up = crossed = np.argwhere(low != high).T
    around = [cell[along, across + a, up + b] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = np.stack(around, axis=1)
    kept = (quads >= 0).all(1)
    outwards = low[tuple(crossed)] != (axis == 1)  # moveaxis mirrors the axes of the middle one
    quads = np.where(outwards[:, None], quads, quads[:, ::-1])
    return np.asarray(quads[kept].astype(np.int32))


def _used(mesh: Mesh) -> Mesh:
    """A mesh without vertices that no quad has."""
    used, numbers = np.unique(mesh.quads, return_inverse=True)
    return Mesh(mesh.vertices[used], numbers.reshape(mesh.quads.shape).astype(np.int32))


_REACH = 4.0  # standard deviations; further from its centre a Gaussian is not drawn


def surface_depth(gaussians: NumpyGaussians, camera: Camera) -> Array:
    """(H, W) float32 planar depth of the surface along each pixel's ray, world units; NaN where the ray goes through.

    The surface is where the Gaussian that takes transmittance through one half is densest along the ray. Its centre,
    which ``Drawing.median_z`` gives, makes steps of a floor that few large Gaussians cover.
    """
    index = draw(gaussians, camera).median_index
    depth = np.full(index.shape, np.nan, np.float32)
    rows, columns = np.nonzero(index >= 0)
    if not rows.size:
        return depth
    which = index[rows, columns]
    rays = planar_rays(camera, rows, columns).astype(np.float32)
    centers = gaussians.means[which] - camera.center.astype(np.float32)
    axes, scales = rotations_of(gaussians.quaternions[which]), np.maximum(gaussians.scales[which], 1e-12)
    local_rays = np.einsum("nij,ni->nj", axes, rays) / scales
    local_centers = np.einsum("nij,ni->nj", axes, centers) / scales
    with np.errstate(over="ignore", invalid="ignore"):
        densest = (local_rays * local_centers).sum(1) / (local_rays**2).sum(1)
        away = np.linalg.norm(rays * densest[:, None] - centers, axis=1)
    planar = centers @ camera.forward.astype(np.float32)
    on_it = np.isfinite(densest) & (densest > 0) & (away <= _REACH * scales.max(1))
    depth[rows, columns] = np.where(on_it, densest, planar)
    return depth


def planar_rays(camera: Camera, rows: Array, columns: Array) -> Float64s:
    """(N, 3) the rays through pixels, in the world's axes, up to a planar depth of 1."""
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    return np.asarray(pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation)


_TRUNCATION = 3.0  # voxels
_SURE, _BEHIND = 0.5, 2.0  # voxels behind a surface up to which a camera's word counts in full, and at all
_AT_ONCE = 1 << 15  # voxels between two words of progress
_LEAST_QUADS = 12
_STEEPEST = 0.1  # cosine; a surface that is seen more from the side counts as seen so
MOST_VOXELS = 1 << 26
"""Of a grid: 256 MB, and a few times that while its surface is looked for."""


@dataclass(frozen=True)
class Grid:
    """Points of a grid along the world's axes.

    Attributes:
        low: (3,) the first point, world units.
        voxel: the distance between points, world units.
        shape: points along x, y and z.
    """

    low: Float64s
    voxel: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, low: Float64s, high: Float64s, voxel: float) -> Grid:
        """A grid that holds a box and a border; FrogError where it would have too many points."""
        border = (_TRUNCATION + 1) * voxel
        counts = np.ceil((high - low + 2 * border) / voxel) + 1
        if not np.isfinite(counts).all() or counts.prod() > MOST_VOXELS:
            said = f"The grid would have {counts.prod():,.0f} points, expected at most {MOST_VOXELS:,}."
            raise FrogError(f"{said} Lower Resolution.")
        return cls(low - border, voxel, (int(counts[0]), int(counts[1]), int(counts[2])))


def fuse(grid: Grid, views: Sequence[tuple[Camera, Array]], done: int) -> Generator[int, None, Mesh]:
    """The surface that depth images show, as a mesh.

    Args:
        grid: where it lies; its spacing is the finest detail.
        views: cameras, and planar depths (H, W) of what they see, NaN where they see through.
        done: is yielded now and then.
    """
    seen = [(camera, depth, _facing(camera, depth)) for camera, depth in views]
    field = np.full(grid.shape, np.nan, np.float32)
    slab = max(1, _AT_ONCE // (grid.shape[1] * grid.shape[2]))
    for first in range(0, grid.shape[0], slab):
        last = min(first + slab, grid.shape[0])
        low = grid.low + np.array([first * grid.voxel, 0, 0])
        part = Grid(low, grid.voxel, (last - first, *grid.shape[1:]))
        field[first:last] = _distances(part, seen)
        yield done
    mesh = without_islands(surface_nets(field), _LEAST_QUADS)
    return Mesh((mesh.vertices * grid.voxel + grid.low).astype(np.float32), mesh.quads)


def _distances(grid: Grid, views: Sequence[tuple[Camera, Array, Array]]) -> Array:
    """Truncated distances at the points of a grid, in truncations; NaN where no camera says anything."""
    total, weights = np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.float32)
    for camera, depth, facing in views:
        distance, straight = _seen_distances(grid, camera, depth, facing)
        distance = distance / np.float32(grid.voxel)
        with np.errstate(invalid="ignore"):
            weight = np.clip((_BEHIND + distance) / (_BEHIND - _SURE), 0.0, 1.0)
            value = np.clip(distance / _TRUNCATION, -1.0, 1.0)
        weight = np.where(np.isnan(distance), 0.0, weight * straight)
        total += np.where(weight > 0, value * weight, 0.0)
        weights += weight
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weights > 0, total / weights, np.nan)


def _seen_distances(grid: Grid, camera: Camera, depth: Array, facing: Array) -> tuple[Array, Array]:
    """Distance of each point before the surface that a camera sees: negative behind, infinite where it sees through,
    NaN outside its image. And the part of ``facing`` that is there."""
    across, down, ahead = _projected(grid, camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = np.floor(across / ahead), np.floor(down / ahead)
    height, width = depth.shape
    inside = (ahead > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    index = np.where(inside, row * width + column, 0).astype(np.int64)
    behind = np.where(np.isnan(depth), np.inf, depth).ravel()[index]
    straight = facing.ravel()[index]
    return np.where(inside, (behind - ahead) * straight, np.nan).astype(np.float32), straight


def _facing(camera: Camera, depth: Array) -> Array:
    """(H, W) by which planar distance from a surface is to be multiplied to be that from its plane: the ray of planar
    length 1 along the surface's normal."""
    height, width = depth.shape
    across, down, middle = np.linalg.inv(camera.intrinsics).T  # how rays change from pixel to pixel
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = columns[..., None] * across + rows[..., None] * down + middle
    far = depth[..., None].astype(np.float64)
    first = across * far + rays * _slope(depth, 1)[..., None]
    second = down * far + rays * _slope(depth, 0)[..., None]
    normal = np.cross(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = np.abs((normal * rays).sum(-1)) / np.linalg.norm(normal, axis=-1)
    return np.where(np.isfinite(facing), np.maximum(facing, _STEEPEST), 1.0).astype(np.float32)


def _slope(depth: Array, axis: int) -> Array:
    """(H, W) change of depth from pixel to pixel along an axis, to the side where it is less: not across edges."""
    step = np.diff(depth, axis=axis, prepend=np.nan, append=np.nan)
    before, after = np.moveaxis(step, axis, 0)[:-1], np.moveaxis(step, axis, 0)[1:]
    with np.errstate(invalid="ignore"):
        less = np.where(np.isnan(after) | (np.abs(before) < np.abs(after)), before, after)
    return np.moveaxis(np.nan_to_num(less), 0, axis)


def _projected(grid: Grid, camera: Camera) -> tuple[Array, Array, Array]:
    """Homogeneous pixel positions of the points: sums of one part for each axis of the grid."""
    matrix = camera.intrinsics @ camera.world_to_camera[:3]
    x, y, z = (grid.low[axis] + grid.voxel * np.arange(count) for axis, count in enumerate(grid.shape))
    return tuple(
        (row[0] * x + row[3]).astype(np.float32)[:, None, None]
        + (row[1] * y).astype(np.float32)[None, :, None]
        + (row[2] * z).astype(np.float32)[None, None, :]
        for row in matrix
    )
