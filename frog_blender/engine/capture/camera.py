"""One pinhole camera, in the project's only convention.

OpenCV axes (x right, y down, z forward), pixel centres at +0.5, an off-centre principal point honoured.
Readers convert to this at the border; nothing else knows another convention.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Float64s
from ..errors import brief, printable
from ..io.plain_values import UnfitValue, entries, number, numbers, plain, text, whole

Item = TypeVar("Item")
Value = TypeVar("Value", bound=np.generic)
NEUTRAL = (1.0, 1.0, 1.0)
"""The exposure of a camera whose images are as bright as the scene."""
MAX_SIDE = 65_536
"""Pixels of an image's width or height: the native code counts tiles in 16 bits, and a side's pixels exactly."""
MAX_PIXELS = 2**26
"""Pixels of a camera's whole image: 8192 x 8192, twice what an 8K video has."""
_MAX_COORDINATE = 1e12  # world units, pixels
_MAX_EXPOSURE = 1e6
_MAX_NAME = 1024  # characters
_MISSING = dict.fromkeys(("name", "width", "height", "intrinsics", "world_to_camera"))
_ZERO, _ONE = 1e-6, 2e-5  # tolerances of the zeros and the one in a calibrated K
_ORTHONORMAL = 0.05  # tolerance of a rotation times its transpose


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without distortion (readers remove it).

    Attributes:
        name: unique within a capture; control characters in it are written out.
        width: pixels.
        height: pixels.
        intrinsics: (3, 3) float64 matrix K, pixels.
        world_to_camera: (4, 4) float64, rigid; ``x_camera = world_to_camera @ x_world``, world units.
        exposure: positive factors for red, green and blue by which its images are brighter than the scene,
            display-referred (see training.optimize.camera_refinement).
    """

    name: str
    width: int
    height: int
    intrinsics: Float64s
    world_to_camera: Float64s
    exposure: tuple[float, float, float] = NEUTRAL

    def __post_init__(self) -> None:
        if not self.name.isprintable():
            object.__setattr__(self, "name", printable(self.name))
        object.__setattr__(self, "intrinsics", np.asarray(self.intrinsics, dtype=np.float64).reshape(3, 3))
        object.__setattr__(self, "world_to_camera", np.asarray(self.world_to_camera, dtype=np.float64).reshape(4, 4))

    @property
    def rotation(self) -> Float64s:
        """(3, 3) world-to-camera rotation."""
        return self.world_to_camera[:3, :3]

    @property
    def center(self) -> Float64s:
        """(3,) camera centre in world units."""
        return -self.rotation.T @ self.world_to_camera[:3, 3]

    @property
    def forward(self) -> Float64s:
        """(3,) unit viewing direction in the world."""
        return np.asarray(self.rotation[2])

    def resized(self, width: int, height: int) -> Camera:
        """The same view sampled with another number of pixels (the intrinsics scale with them)."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, width=width, height=height, intrinsics=scale @ self.intrinsics)

    def scaled(self, factor: float) -> Camera:
        """The same view with so many times the pixels along each side, rounded."""
        return self.resized(max(1, round(self.width * factor)), max(1, round(self.height * factor)))

    def with_pose(self, world_to_camera: Float64s) -> Camera:
        """The same camera elsewhere; ``world_to_camera`` is (3, 4) or (4, 4)."""
        return replace(self, world_to_camera=np.vstack([world_to_camera[:3], [[0.0, 0.0, 0.0, 1.0]]]))

    def with_exposure(self, exposure: Iterable[float]) -> Camera:
        """The same camera, exposed otherwise; ValueError unless ``exposure`` is three positive numbers."""
        red, green, blue = (float(factor) for factor in exposure)
        if not all(0 < factor < math.inf for factor in (red, green, blue)):
            raise ValueError(f"an exposure of {red:g}, {green:g}, {blue:g}")
        return replace(self, exposure=(red, green, blue))

    def moved(self, turn: Float64s, shift: Float64s) -> Camera:
        """The camera turned about its centre, then shifted, both along its own axes.

        Args:
            turn: (3,) axis times angle in radians, by which the world turns as the camera sees it.
            shift: (3,) world units, by which the world moves as the camera sees it.
        """
        pose = rotation_about(turn) @ self.world_to_camera[:3]
        pose[:, 3] += shift
        return self.with_pose(pose)

    def cropped(self, left: float, top: float, width: int, height: int) -> Camera:
        """The view through the pixel rectangle that starts at (left, top); it may reach outside the image."""
        shift = np.array([[1.0, 0.0, -left], [0.0, 1.0, -top], [0.0, 0.0, 1.0]])
        return replace(self, width=width, height=height, intrinsics=shift @ self.intrinsics)

    def project(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """Pixel positions (N, 2) and planar depths (N,) of world points (N, 3); depth <= 0 lies behind."""
        local = points @ self.rotation.T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        pixels = local @ self.intrinsics.T
        return pixels[:, :2] / safe[:, None], depth

    def sample(self, points: Float64s, image: NDArray[Value]) -> tuple[NDArray[Value], Bools]:
        """Values (N, ...) of an image of the camera's size where world points (N, 3) project, and whether (N,) it sees
        them at all."""
        pixels, depths = self.project(points)
        # The clip keeps the conversion to integers defined; positions far outside stay outside.
        columns, lines = np.floor(np.clip(np.nan_to_num(pixels, nan=-1.0), -1.0, 1e6)).astype(int).T
        height, width = image.shape[:2]
        seen = (depths > 0) & (columns >= 0) & (lines >= 0) & (columns < width) & (lines < height)
        return image[np.where(seen, lines, 0), np.where(seen, columns, 0)], seen

    def ray_directions(self, pixels: Float64s) -> Float64s:
        """(N, 3) unit world directions through pixel positions (N, 2)."""
        homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
        directions = homogeneous @ np.linalg.inv(self.intrinsics).T @ self.rotation
        return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))

    def unproject(self, pixels: Float64s, distances: Float64s) -> Float64s:
        """(N, 3) world points at Euclidean distances (N,) from the centre, through pixel positions (N, 2)."""
        return self.center + self.ray_directions(pixels) * distances[:, None]

    def to_json(self) -> dict[str, object]:
        """A plain dictionary for headers; ``from_json`` reads it back."""
        values: dict[str, object] = plain(self)
        if self.exposure == NEUTRAL:
            del values["exposure"]
        return values

    @classmethod
    def from_json(cls, data: object) -> Camera:
        """The camera of ``to_json``; UnfitValue for data that is not a valid camera."""
        data = _MISSING | entries(data, "a camera")
        name = text(data["name"], "a camera's name", _MAX_NAME)
        width, height = (whole(data[side], f"the {side} of camera {name}", 1, MAX_SIDE) for side in ("width", "height"))
        if width * height > MAX_PIXELS:
            raise UnfitValue(f"camera {name} of {width} x {height} pixels", f"at most {MAX_PIXELS:,} in all")
        return cls(
            name,
            width,
            height,
            _lens(data["intrinsics"], f"the intrinsics of camera {name}"),
            _pose(data["world_to_camera"], f"the pose of camera {name}"),
            _exposure(data["exposure"], f"the exposure of camera {name}") if "exposure" in data else NEUTRAL,
        )


def exact_pinhole(matrix: Float64s) -> Float64s | None:
    """(3, 3) K with its zeros and its one exact, if they are so up to rounding; else None."""
    _, (lean, _, _), (left, right, one) = matrix.tolist()  # plain numbers: a moving camera has thousands
    if not lean and [left, right, one] == [0, 0, 1]:
        return matrix
    if max(abs(lean), abs(left), abs(right)) > _ZERO or abs(one - 1) > _ONE:
        return None
    exact = matrix.copy()
    exact[1, 0], exact[2] = 0, (0, 0, 1)
    return exact


def _exposure(value: object, what: str) -> tuple[float, float, float]:
    red, green, blue = numbers(value, what, (3,), _MAX_EXPOSURE).tolist()
    if min(red, green, blue) <= 0:
        raise UnfitValue(f"{what} = {brief(value)}", "three positive numbers")
    return red, green, blue


def _lens(value: object, what: str) -> Float64s:
    """(3, 3) matrix K from a header; UnfitValue unless it is that of a pinhole camera."""
    matrix = numbers(value, what, (3, 3), _MAX_COORDINATE)
    number(min(matrix.diagonal().tolist()[:2]), f"a focal length in {what}", 1e-6, _MAX_COORDINATE)
    exact = exact_pinhole(matrix)
    if exact is None:
        raise UnfitValue(f"{what} with the rows {matrix.tolist()}", "zeros below the focal lengths, and 0, 0, 1")
    return exact


def _pose(value: object, what: str) -> Float64s:
    """(4, 4) pose from a header; UnfitValue unless it is rigid."""
    matrix = numbers(value, what, (4, 4), _MAX_COORDINATE)
    rotation, last = matrix[:3, :3], matrix[3].tolist()
    if np.linalg.det(rotation) < 0 or np.abs(rotation @ rotation.T - np.eye(3)).max() > _ORTHONORMAL:
        raise UnfitValue(f"{what} that mirrors, scales or shears ({rotation.tolist()})", "a rotation")
    if last != [0, 0, 0, 1]:
        raise UnfitValue(f"{what} with the last row {last}", "0, 0, 0, 1")
    return matrix


def rotation_about(vector: Float64s) -> Float64s:
    """(3, 3) rotation about ``vector`` (3,) by its length in radians (Rodrigues)."""
    x, y, z = vector.tolist()  # plain numbers: a training asks at every step
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return np.eye(3)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = math.sin(angle), math.cos(angle)
    return np.asarray(np.eye(3) + sine / angle * cross + (1 - cosine) / angle**2 * (cross @ cross))


def cameras_move(images_per_camera: Iterable[int], training_frames: Sequence[int], *, rig: bool = False) -> bool:
    """Whether each camera stands for one image of a moving camera: the one definition, for captures and headers.

    Args:
        images_per_camera: of every camera.
        training_frames: of every image that may be trained on. Held-out images do not count: of a rig of two cameras
            one may be trained on and the other judge.
        rig: several cameras may have moved together, so that images may share a frame.
    """
    frames = set(training_frames)
    if any(count != 1 for count in images_per_camera) or len(frames) < 2:
        return False
    return rig or len(frames) == len(training_frames)


_LOOKED_THROUGH = 48  # cameras at most: more would see hardly anything else


def evenly_chosen(cameras: Sequence[Item]) -> Sequence[Item]:
    """Of cameras, or of what stands for them, at most as many as are worth looking through."""
    return cameras[:: -(-len(cameras) // _LOOKED_THROUGH)]
