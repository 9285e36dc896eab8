"""Proxy meshes of a scene: one of what stays where it is, and one a frame of what moves."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import GaussianArrays, NumpyGaussians
from .fusion import Grid, Mesh, fuse, surface_depth

Frames = Sequence[Callable[[], NumpyGaussians]]
"""The Gaussians of each frame, computed when they are asked for."""

_MOST_CAMERAS = 24
_PIXELS = 2  # of a depth image's longest side, for each voxel along the scene
_FADES = 0.3  # change of opacity by which a Gaussian comes and goes
_SEEN = 0.01, 0.99  # quantiles of the seen surface; single pixels see floaters kilometres away
_ROOM = 0.25  # around what is seen first, in its longest side: how far later frames may reach
_AROUND = 2.5  # distance of cameras around a scene that has none, in its reaches
RESOLUTIONS = 8, 256
"""The least and the largest number of voxels along the longest side: with room for later frames, what a grid holds."""


@dataclass
class Proxy:
    """Meshes of a scene, in its own coordinates.

    Attributes:
        still: of what stays where it is; without quads where everything moves.
        moving: of what moves, one a frame; empty where nothing does. Frames that show the same share one.
        voxel: their finest detail, world units.
    """

    still: Mesh
    moving: list[Mesh] = field(default_factory=list)
    voxel: float = 0.0


def steps_of(count: int) -> int:
    """How many steps ``make_proxy`` has for so many frames."""
    return count + 1 + count


def make_proxy(
    frames: Frames, cameras: Sequence[Camera], resolution: int, *, keeps_identity: bool = True
) -> Generator[int, None, Proxy]:
    """Fuses what cameras see of a scene into meshes; yields how many of ``steps_of`` steps are done.

    Args:
        frames: at least one.
        cameras: of the capture; where there are none, the scene is looked at from all around.
        resolution: voxels along the longest side of what the cameras see, within RESOLUTIONS.
        keeps_identity: whether the same row is the same Gaussian in all frames. Otherwise everything counts as moving.

    Raises:
        FrogError: where nothing is seen, or the grid would be too large.
    """
    if not RESOLUTIONS[0] <= resolution <= RESOLUTIONS[1]:
        raise ValueError(f"resolution: {resolution}, expected {RESOLUTIONS[0]} to {RESOLUTIONS[1]}")
    motion = Motion()
    for index, frame in enumerate(frames if keeps_identity else ()):
        motion.add(frame())
        yield index + 1
    done = steps_of(len(frames)) - len(frames) - 1
    first = frames[0]()
    if not len(first):
        raise FrogError(_UNSEEN)
    views = yield from _views(first, _looking(cameras, first, resolution), done)
    low, high = _seen_box(views)
    proxy, eyes = Proxy(_NOTHING, voxel=float((high - low).max()) / resolution), [camera for camera, _ in views]
    room = _ROOM * float((high - low).max())
    viewing = _Viewing(eyes, proxy.voxel, low - room, high + room)
    moves = motion.moves(proxy.voxel)
    if len(frames) == 1:
        moves = np.zeros(len(first), bool)
    elif moves is None:
        moves = np.ones(len(first), bool)
    proxy.still = yield from _surface(_part(first, ~moves), viewing, done)
    yield done + 1
    known: dict[bytes, Mesh] = {}  # frames that are held or repeated
    for number, frame in enumerate(frames if moves.any() else ()):
        gaussians = frame()
        moving = _part(gaussians, moves) if len(gaussians) == len(moves) else gaussians
        key = _digest(moving)
        if key not in known:
            known[key] = yield from _surface(moving, viewing, done + 1 + number)
        proxy.moving.append(known[key])
        yield done + 2 + number
    if not len(proxy.still.quads) and not any(len(mesh.quads) for mesh in proxy.moving):
        raise FrogError("The cameras see no closed surface in this capture, so there is nothing to make a mesh of.")
    return proxy


@dataclass(frozen=True)
class _Viewing:
    """From where a scene is seen in all its frames.

    Attributes:
        cameras: with images as fine as a mesh needs.
        voxel: world units.
        low, high: (3,) corners of the box in which surfaces are expected.
    """

    cameras: Sequence[Camera]
    voxel: float
    low: Float64s
    high: Float64s

    def box(self, low: Float64s, high: Float64s) -> tuple[Float64s, Float64s]:
        """A box, cut where it is longer than what is expected: a floater far away would need a grid up to it."""
        is_long = high - low > (self.high - self.low).max()
        return np.where(is_long, np.maximum(low, self.low), low), np.where(is_long, np.minimum(high, self.high), high)


class Motion:
    """Finds the Gaussians that do not stay as they are over several frames."""

    def __init__(self) -> None:
        self._low: tuple[Array, Array] | None = None
        self._high: tuple[Array, Array] | None = None
        self._is_comparable = True

    def add(self, gaussians: NumpyGaussians) -> None:
        """Looks at another frame."""
        values = gaussians.means, gaussians.opacities
        if self._low is None or self._high is None:
            self._low = self._high = values
        elif len(self._low[0]) != len(gaussians):
            self._is_comparable = False
        else:
            self._low = np.minimum(self._low[0], values[0]), np.minimum(self._low[1], values[1])
            self._high = np.maximum(self._high[0], values[0]), np.maximum(self._high[1], values[1])

    def moves(self, distance: float) -> Array | None:
        """(N,) bool whether each moves by more than a distance in world units, or comes and goes; None where frames
        have different numbers of Gaussians."""
        if self._low is None or self._high is None or not self._is_comparable:
            return None
        distances = np.linalg.norm(self._high[0] - self._low[0], axis=1)
        result: Array = (distances > distance) | (self._high[1] - self._low[1] > _FADES)
        return result


def _digest(gaussians: NumpyGaussians) -> bytes:
    """The same for Gaussians that are equal."""
    digest = hashlib.blake2b(digest_size=16)
    for array in vars(gaussians).values():
        digest.update(np.ascontiguousarray(array).ravel().data)
    return digest.digest()


def _part(gaussians: NumpyGaussians, kept: Array) -> NumpyGaussians:
    return GaussianArrays(*(array[kept] for array in vars(gaussians).values()))


def _surface(gaussians: NumpyGaussians, viewing: _Viewing, done: int) -> Generator[int, None, Mesh]:
    """The mesh of Gaussians as cameras see them."""
    if not len(gaussians):
        return _NOTHING
    views = yield from _views(gaussians, viewing.cameras, done)
    if not any(np.isfinite(depth).any() for _, depth in views):
        return _NOTHING
    low, high = viewing.box(*_seen_box(views))
    if (high < low).any():
        return _NOTHING
    steps = fuse(Grid.around(low, high, viewing.voxel), views)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            mesh: Mesh = end.value
            return mesh
        yield done


def _views(
    gaussians: NumpyGaussians, cameras: Sequence[Camera], done: int
) -> Generator[int, None, list[tuple[Camera, Array]]]:
    views = []
    for camera in cameras:
        views.append((camera, surface_depth(gaussians, camera)))
        yield done
    return views


def _seen_box(views: Sequence[tuple[Camera, Array]]) -> tuple[Float64s, Float64s]:
    """The corners (3,) of a box around nearly all that cameras see; FrogError where that is nothing."""
    seen = []
    for camera, depth in views:
        rows, columns = np.nonzero(np.isfinite(depth))
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
        rays = pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
        seen.append(camera.center + rays * depth[rows, columns, None])
    points = np.concatenate(seen)
    if not len(points):
        raise FrogError(_UNSEEN)
    low, high = np.quantile(points, _SEEN, axis=0)
    return low, high


def _looking(cameras: Sequence[Camera], gaussians: NumpyGaussians, resolution: int) -> list[Camera]:
    """Some of a capture's cameras, or cameras around a scene, with images as fine as a mesh needs."""
    chosen = np.unique(np.linspace(0, len(cameras) - 1, _MOST_CAMERAS).round().astype(int)) if cameras else ()
    found = [cameras[index] for index in chosen] or _around(gaussians)
    side = _PIXELS * resolution
    factors = [side / max(camera.width, camera.height) for camera in found]
    return [camera.scaled(factor) for camera, factor in zip(found, factors, strict=True)]


def _around(gaussians: NumpyGaussians) -> list[Camera]:
    """Cameras on a sphere around a scene, evenly spread (Fibonacci's spiral)."""
    low, high = np.quantile(gaussians.means.astype(np.float64), _SEEN, axis=0)
    middle, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    heights = 1 - 2 * (np.arange(_MOST_CAMERAS) + 0.5) / _MOST_CAMERAS
    angles = np.pi * (3 - np.sqrt(5)) * np.arange(_MOST_CAMERAS)
    flat = np.sqrt(1 - heights**2)
    backwards = np.stack([flat * np.cos(angles), flat * np.sin(angles), heights], axis=1)
    focal = 1.6 * _AROUND  # pixels of 4 x 4: all of the scene and a border
    intrinsics = np.array([[focal, 0, 2], [0, focal, 2], [0, 0, 1]])
    cameras = []
    for index, back in enumerate(backwards):
        right = np.cross(back, np.eye(3)[np.abs(back).argmin()])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(-back, right), -back]
        pose[:3, 3] = -pose[:3, :3] @ (middle + _AROUND * reach * back)
        cameras.append(Camera(f"around {index}", 4, 4, intrinsics, pose))
    return cameras


_UNSEEN = "The cameras see no surface in this capture, so there is nothing to make a mesh of."
_NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.int32))
