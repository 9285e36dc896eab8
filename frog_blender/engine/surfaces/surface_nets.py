"""The surface where a field on a grid is zero, as a mesh of quads.

Surface nets (Gibson, "Constrained Elastic Surface Nets", 1998), without relaxation: one vertex for each cell that the
surface passes, at the mean of where it crosses the cell's edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..arrays import Array
from ..editing.clusters import components


@dataclass(frozen=True)
class Mesh:
    """A mesh of quads.

    Attributes:
        vertices: (V, 3) float32, world units.
        quads: (F, 4) int32 indices of vertices, counter-clockwise from outside.
    """

    vertices: Array
    quads: Array


_CORNERS = np.array(list(product((0, 1), repeat=3)))
_EDGES = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1])


def surface_nets(field: Array) -> Mesh:
    """The zero surface of a field, in units of the grid.

    Args:
        field: (X, Y, Z) values at grid points (x, y, z): positive outside, NaN where nothing is known. There the
            surface has an edge.
    """
    cells = _crossed_cells(field)
    if not len(cells):
        return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.int32))
    values = np.stack([field[tuple((cells + corner).T)] for corner in _CORNERS], axis=1)
    first, second = values[:, _EDGES[:, 0]], values[:, _EDGES[:, 1]]
    crossed = (first < 0) != (second < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crossed, first / (first - second), 0.0)
    start, step = _CORNERS[_EDGES[:, 0]], _CORNERS[_EDGES[:, 1]] - _CORNERS[_EDGES[:, 0]]
    points = (start + share[..., None] * step) * crossed[..., None]
    vertices = cells + points.sum(1) / crossed.sum(1)[:, None]
    number = np.full([max(size - 1, 0) for size in field.shape], -1, np.int32)
    number[tuple(cells.T)] = np.arange(len(cells))
    quads = np.concatenate([_quads_across(field, number, axis) for axis in range(3)])
    return _used(Mesh(vertices.astype(np.float32), quads))


def without_islands(mesh: Mesh, least: int) -> Mesh:
    """A mesh without the connected parts of fewer than so many quads: what floats in the air and shadows nothing."""
    if not len(mesh.quads):
        return mesh
    starts = np.repeat(mesh.quads[:, 0], 3)
    part = components(starts, mesh.quads[:, 1:].ravel(), len(mesh.vertices))[mesh.quads[:, 0]]
    return _used(Mesh(mesh.vertices, mesh.quads[np.bincount(part)[part] >= least]))


def _crossed_cells(field: Array) -> Array:
    """(M, 3) the cells, by their lowest corners, that have known values of both signs at their corners."""
    if min(field.shape) < 2:
        return np.zeros((0, 3), np.int64)
    inside, known = field < 0, np.isfinite(field)
    some, every = _over_corners(np.logical_or, inside), _over_corners(np.logical_and, inside)
    return np.argwhere(some & ~every & _over_corners(np.logical_and, known))


def _over_corners(combine: np.ufunc, values: Array) -> Array:
    """Combines the values at the eight corners of each cell."""
    for axis in range(3):
        ahead = np.moveaxis(values, axis, 0)
        values = np.moveaxis(combine(ahead[:-1], ahead[1:]), 0, axis)
    return values


def _quads_across(field: Array, number: Array, axis: int) -> Array:
    """(F, 4) the quads across crossed edges of the grid along an axis: each joins the four cells around the edge."""
    ahead = np.moveaxis(field, axis, 0)
    cell = np.moveaxis(number, axis, 0)
    with np.errstate(invalid="ignore"):
        low, high = ahead[:-1, 1:-1, 1:-1] < 0, ahead[1:, 1:-1, 1:-1] < 0
    place = np.argwhere(low != high)
    along, across, up = place.T
    around = [cell[along, across + a, up + b] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = np.stack(around, axis=1)
    kept = (quads >= 0).all(1)
    outwards = low[tuple(place.T)] != (axis == 1)  # moveaxis mirrors the axes of the middle one
    quads = np.where(outwards[:, None], quads, quads[:, ::-1])
    result: Array = quads[kept].astype(np.int32)
    return result


def _used(mesh: Mesh) -> Mesh:
    """A mesh without vertices that no quad has."""
    used, numbers = np.unique(mesh.quads, return_inverse=True)
    return Mesh(mesh.vertices[used], numbers.reshape(mesh.quads.shape).astype(np.int32))
