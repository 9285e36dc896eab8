"""Proxy meshes of a scene: one of what stays where it is, and one a frame of what moves."""

import hashlib
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import NumpyGaussians
from .fusion import NOTHING, Grid, Mesh, fuse, planar_rays, surface_depth

Frames = Sequence[Callable[[], NumpyGaussians]]
"""The Gaussians of each frame, computed when they are asked for."""

_MOST_CAMERAS = 24
_PIXELS = 2  # of a depth image's longest side, for each voxel along the scene
_FADES = 0.3  # change of opacity by which a Gaussian comes and goes
_SEEN = 0.01, 0.99  # quantiles of the seen surface; single pixels see floaters kilometres away
_ROOM = 0.25  # around what is seen first, in its longest side: how far later frames may reach
_AROUND = 2.5  # distance of cameras around a scene that has none, in its reaches


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
        resolution: voxels along the longest side of what the cameras see.
        keeps_identity: whether the same row is the same Gaussian in all frames. Otherwise everything counts as moving.

    Raises:
        FrogError: where nothing is seen, or the grid would be too large.
    """
    motion = (yield from _motion(frames)) if keeps_identity else None
    done = len(frames)
    first = frames[0]()
    if not len(first):
        raise FrogError(_UNSEEN)
    views = yield from _views(first, _looking(cameras, first, resolution), done)
    low, high = _seen_box(views)
    longest = float((high - low).max())
    proxy, eyes = Proxy(NOTHING, voxel=longest / resolution), [camera for camera, _ in views]
    room = low - _ROOM * longest, high + _ROOM * longest
    moves = np.full(len(first), len(frames) > 1)
    if motion is not None:
        moves = (np.linalg.norm(motion[:, :3], axis=1) > proxy.voxel) | (motion[:, 3] > _FADES)
    proxy.still = yield from _surface(first.part(~moves), eyes, proxy.voxel, room, done)
    yield done + 1
    known: dict[bytes, Mesh] = {}  # frames that are held or repeated
    for index, frame in enumerate(frames if moves.any() else ()):
        gaussians = frame()
        moving = gaussians.part(moves) if len(gaussians) == len(moves) else gaussians
        key = _digest(moving)
        if key not in known:
            known[key] = yield from _surface(moving, eyes, proxy.voxel, room, done + 1 + index)
        proxy.moving.append(known[key])
        yield done + 2 + index
    if not len(proxy.still.quads) and not any(len(mesh.quads) for mesh in proxy.moving):
        raise FrogError("The cameras see no closed surface in this capture, so there is nothing to make a mesh of.")
    return proxy


def _motion(frames: Frames) -> Generator[int, None, Array | None]:
    """(N, 4) by how much each Gaussian's place and opacity change over the frames; None where these have different
    numbers of Gaussians."""
    low = high = None
    is_comparable = True
    for index, frame in enumerate(frames):
        gaussians = frame()
        values = np.column_stack([gaussians.means, gaussians.opacities])
        if low is None or high is None:
            low = high = values
        elif is_comparable := is_comparable and len(low) == len(values):
            low, high = np.minimum(low, values), np.maximum(high, values)
        yield index + 1
    return high - low if is_comparable and low is not None else None


def _digest(gaussians: NumpyGaussians) -> bytes:
    """The same for Gaussians that are equal."""
    digest = hashlib.blake2b(digest_size=16)
    for array in gaussians.arrays.values():
        digest.update(np.ascontiguousarray(array).ravel().data)
    return digest.digest()


def _surface(
    gaussians: NumpyGaussians, cameras: Sequence[Camera], voxel: float, room: tuple[Float64s, Float64s], done: int
) -> Generator[int, None, Mesh]:
    """The mesh of Gaussians as cameras see them.

    Args:
        room: (3,) corners of the box in which surfaces are expected.
    """
    views = (yield from _views(gaussians, cameras, done)) if len(gaussians) else []
    if not any(np.isfinite(depth).any() for _, depth in views):
        return NOTHING
    low, high = _seen_box(views)
    is_long = high - low > (room[1] - room[0]).max()  # a floater far away would need a grid up to it
    low, high = np.where(is_long, np.maximum(low, room[0]), low), np.where(is_long, np.minimum(high, room[1]), high)
    if (high < low).any():
        return NOTHING
    return (yield from fuse(Grid.around(low, high, voxel), views, done))


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
        seen.append(camera.center + planar_rays(camera, rows, columns) * depth[rows, columns, None])
    points = np.concatenate(seen)
    if not len(points):
        raise FrogError(_UNSEEN)
    low, high = np.quantile(points, _SEEN, axis=0)
    return low, high


def _looking(cameras: Sequence[Camera], gaussians: NumpyGaussians, resolution: int) -> list[Camera]:
    """Some of a capture's cameras, or cameras around a scene, with images as fine as a mesh needs."""
    chosen = np.unique(np.linspace(0, len(cameras) - 1, _MOST_CAMERAS).round().astype(int)) if cameras else ()
    looking = [cameras[index] for index in chosen] or _around(gaussians)
    return [camera.scaled(_PIXELS * resolution / max(camera.width, camera.height)) for camera in looking]


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
