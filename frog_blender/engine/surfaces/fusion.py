"""Depth images fused into one surface.

Curless and Levoy, "A Volumetric Method for Building Complex Models from Range Images" (1996): on a grid, the signed
distance to the surface that each camera sees, truncated and averaged over the cameras, each weighted by how straight it
looks at the surface. The distance is to the plane that the surface is around a pixel: along its ray, a floor that is
seen from the side would be many voxels away. Space that a camera sees through counts as empty; what no camera sees into
stays unknown, and there the surface ends.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from ..errors import FrogError
from .surface_nets import Mesh, surface_nets, without_islands

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
            found = f"The grid would have {counts.prod():,.0f} points, expected at most {MOST_VOXELS:,}."
            raise FrogError(f"{found} Lower Resolution.")
        return cls(low - border, voxel, (int(counts[0]), int(counts[1]), int(counts[2])))


def fuse(grid: Grid, views: Sequence[tuple[Camera, Array]]) -> Generator[float, None, Mesh]:
    """The surface that depth images show, as a mesh; yields what share of the work is done.

    Args:
        grid: where it lies; its spacing is the finest detail.
        views: cameras, and planar depths (H, W) of what they see, NaN where they see through.
    """
    seen = [(camera, depth, _facing(camera, depth)) for camera, depth in views]
    field = np.full(grid.shape, np.nan, np.float32)
    slab = max(1, _AT_ONCE // (grid.shape[1] * grid.shape[2]))
    for first in range(0, grid.shape[0], slab):
        last = min(first + slab, grid.shape[0])
        low = grid.low + np.array([first * grid.voxel, 0, 0])
        part = Grid(low, grid.voxel, (last - first, *grid.shape[1:]))
        field[first:last] = _distances(part, seen)
        yield last / grid.shape[0]
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
