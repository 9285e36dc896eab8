"""Crops: a box, a sphere or a closed mesh, and how much of a Gaussian at a place is kept."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce

import numpy as np

from ..arrays import Array
from .box_tree import BoxTree
from .closed_mesh import ClosedMesh

BOX, SPHERE, MESH = SHAPES = ("box", "sphere", "mesh")
_HARD = 1e-12  # world units: over less of them nothing fades, and distances divided by it are numbers


@dataclass(frozen=True)
class Crop:
    """One crop.

    Attributes:
        shape: one of SHAPES: the cube from -1 to 1, the unit sphere, or ``mesh``.
        matrix: (16,) row by row, from the shape's space to the scene's; can be inverted. One that mirrors leaves inside
            what is inside.
        keep_inside: keep what is inside; else what is outside.
        feather: world units from the surface, away from what is kept, over which opacity falls to zero.
        time: in [0, 1], at which a Gaussian's place decides; None for the time that is shown.
        mesh: for MESH.
        is_still: it will be at the same place at the next frame, so that what it hides need not be played.

    Raises:
        ValueError: for what cannot be.
    """

    shape: str
    matrix: tuple[float, ...]
    keep_inside: bool = True
    feather: float = 0.0
    time: float | None = None
    mesh: ClosedMesh | None = None
    is_still: bool = True

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ValueError(f"a crop of the shape {self.shape!r}")
        if (self.mesh is not None) != (self.shape == MESH):
            raise ValueError("a mesh crop without a mesh, or another with one")
        if len(self.matrix) != 16 or not all(map(math.isfinite, self.matrix)):
            raise ValueError("a crop whose matrix is not 16 finite numbers")
        if self.matrix[12:] != (0, 0, 0, 1):
            raise ValueError("a crop whose matrix is none of a placed object")
        if _inverse(self.matrix) is None:
            raise ValueError("a crop scaled to nothing along an axis")
        if not 0 <= self.feather < math.inf:
            raise ValueError(f"a feather of {self.feather}")
        if self.time is not None and not 0 <= self.time <= 1:
            raise ValueError(f"a crop at the time {self.time}")

    def kept(self, points: Array) -> Array:
        """(N,) float32 in [0, 1]: the share of the opacity of Gaussians at (N, 3) that is kept."""
        inverse = _inverse(self.matrix)
        assert inverse is not None
        # (3, N): numpy adds to short rows, and looks for their largest numbers, ten times as slowly.
        local: Array = inverse[:3, :3].astype(np.float32) @ points.T
        local += inverse[:3, 3:].astype(np.float32)
        if self.mesh is not None:
            kept: Array = (self.mesh.contains(local.T) == self.keep_inside).astype(np.float32)
            if self.feather > _HARD:
                fading = np.flatnonzero(kept == 0)
                kept[fading] = 1 - self._surface.within(points[fading], self.feather) / self.feather
            return kept
        if self.feather > _HARD:
            outside = self._distance(local, inverse[:3, :3])
            beyond = outside if self.keep_inside else -outside
            kept = np.clip(1 - beyond / np.float32(self.feather), 0, 1)
        else:
            inside = (np.abs(local).max(0) if self.shape == BOX else np.einsum("in,in->n", local, local)) <= 1
            kept = inside == self.keep_inside
        return kept.astype(np.float32)

    @cached_property
    def _surface(self) -> BoxTree:
        """Of the mesh where it stands: distances in a space that it is scaled in unevenly are none."""
        assert self.mesh is not None
        matrix = np.array(self.matrix).reshape(4, 4)
        vertices, triangles = self.mesh.arrays
        return BoxTree((vertices @ matrix[:3, :3].T + matrix[:3, 3])[triangles])

    def _distance(self, local: Array, to_shape: Array) -> Array:
        """(N,) signed distance in world units from the surface, negative inside: of a box exact unless it is sheared,
        of an ellipsoid to first order. ``local`` is (3, N), in the shape's space."""
        if self.shape == BOX:
            sides = np.linalg.norm(np.linalg.inv(to_shape), axis=0).astype(np.float32)
            offsets = (np.abs(local) - 1) * sides[:, None]
            far: Array = np.linalg.norm(np.maximum(offsets, 0), axis=0)
            far += np.minimum(offsets.max(axis=0), 0)
            return far
        length = np.maximum(np.linalg.norm(local, axis=0), 1e-9)
        slope = np.linalg.norm(to_shape.T.astype(np.float32) @ local, axis=0) / length
        return np.asarray((length - 1) / np.maximum(slope, 1e-9))


@lru_cache(maxsize=64)
def _inverse(matrix: tuple[float, ...]) -> Array | None:
    """(4, 4) the inverse of a matrix in rows; None for one that flattens. The same crop asks in every frame."""
    rows = np.array(matrix).reshape(4, 4)
    if np.linalg.cond(rows[:3, :3]) > 1e9:
        return None
    inverse: Array = np.linalg.inv(rows)
    inverse.flags.writeable = False
    return inverse


def kept_of_all(crops: Sequence[Crop], kept: Sequence[Array], count: int) -> Array:
    """(count,) float32 in [0, 1] what several crops keep together: what is in any of those that keep their inside, and
    out of all that keep their outside.

    Args:
        kept: (count,) what each keeps alone.
    """
    inner = [share for crop, share in zip(crops, kept, strict=True) if crop.keep_inside]
    outer = [share for crop, share in zip(crops, kept, strict=True) if not crop.keep_inside]
    return reduce(np.multiply, outer, reduce(np.maximum, inner) if inner else np.ones(count, np.float32))
