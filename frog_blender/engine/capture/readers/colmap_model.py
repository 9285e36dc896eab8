"""COLMAP's sparse model, binary or text: ``cameras``, ``images``, ``points3D`` and, from 3.12 on, ``frames``.

Poses take world to camera in OpenCV's axes: a quaternion w x y z and a translation. Pixel centres lie at +0.5, as in
this project. Counts are little-endian 64-bit numbers; nothing is made room for before it is read.
(colmap/colmap, src/colmap/scene/reconstruction_io_binary.cc and reconstruction_io_text.cc; src/colmap/sensor/models.h.)

``rigs`` is not needed: ``images`` says every image's own pose. ``frames`` says which images were taken at one time.
"""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ...io.regular_file import check_length, regular_file
from ..camera import Camera
from ..capture import Distortion
from ..lenses import FISHEYE, FOV, THIN_PRISM_FISHEYE
from .checks import number, numbers, size, usable_points
from .geometry import distortion, from_quaternion, intrinsics, through_lens

_PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "SIMPLE_FISHEYE": 3,
    "FISHEYE": 4,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}
"""How many parameters each model of a lens has, in the order of COLMAP's numbers for them."""
_MODELS = tuple(_PARAMETERS)
_ONE_FOCAL = frozenset({"RADIAL", "RADIAL_FISHEYE", *(name for name in _MODELS if name.startswith("SIMPLE"))})
_WITHOUT_READER = frozenset({"RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM", "EQUIRECTANGULAR"})
_MOST_POINTS = 2_000_000
_LONGEST_NAME = 1000  # characters
_A_CAMERA = 0  # kind of sensor
_LINES = {
    "cameras": "CAMERA_ID MODEL WIDTH HEIGHT PARAMS of a known model",
    "images": "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
    "points3D": "POINT3D_ID X Y Z",
    "frames": "FRAME_ID RIG_ID RIG_FROM_WORLD DATA_IDS",
}
"""Of a text file."""


@dataclass(frozen=True, eq=False)
class PosedImage:
    """An image of the model.

    Attributes:
        name: as COLMAP was given it: a path below its folder of images, with slashes.
        camera: id in ``Model.lenses``.
        pose: (4, 4) world to camera.
    """

    name: str
    camera: int
    pose: Float64s

    @property
    def center(self) -> Float64s:
        """(3,) of the camera, world units."""
        return -self.pose[:3, :3].T @ self.pose[:3, 3]


@dataclass(frozen=True, eq=False)
class Model:
    """A sparse model.

    Attributes:
        folder: with its files.
        lenses: by camera id: the model's name, width, height, parameters.
        images: with poses, in the file's order.
        points: (N, 3) world units.
        frames: the frame of each image's name, of models whose rigs have several cameras; else empty.
    """

    folder: Path
    lenses: dict[int, tuple[str, int, int, Float64s]]
    images: list[PosedImage]
    points: Float64s
    frames: dict[str, int] = field(default_factory=dict)

    def camera(self, image: PosedImage, name: str) -> tuple[Camera, Distortion | None]:
        """The camera of an image at its calibrated size, and its lens's distortion.

        Raises:
            FrogError: for a lens model without a reader, or a focal length that is not positive.
        """
        model, width, height, values = self.lenses[image.camera]
        if model in _WITHOUT_READER:
            expected = "PINHOLE, OPENCV or OPENCV_FISHEYE (COLMAP's image_undistorter writes PINHOLE)"
            raise found_instead(self.folder, f"cameras of the model {model}", expected)
        focal_x, focal_y, center_x, center_y, *rest = [values[0], *values] if model in _ONE_FOCAL else values
        if min(focal_x, focal_y) <= 0:
            raise found_instead(self.folder, f"a focal length of {min(focal_x, focal_y):g}", "a positive one")
        camera = Camera(name, width, height, intrinsics(focal_x, focal_y, center_x, center_y), image.pose)
        return _with_lens(camera, model, rest, self.folder)


def _with_lens(camera: Camera, model: str, rest: list[float], path: Path) -> tuple[Camera, Distortion | None]:
    """A camera and its distortion by the parameters that follow focal lengths and principal point."""
    if model == "FOV":
        if not 1e-3 <= rest[0] <= 3.1:
            raise found_instead(path, f"omega = {rest[0]:g} in a FOV camera", "radians between 0 and pi")
        return through_lens(camera, FOV, np.array(rest), path)
    if model == "THIN_PRISM_FISHEYE":
        return through_lens(camera, THIN_PRISM_FISHEYE, np.array(rest), path)
    if model.endswith("FISHEYE"):
        return through_lens(camera, FISHEYE, np.array([*rest, 0.0, 0.0, 0.0, 0.0][:4]), path)
    coefficients = np.zeros(8 if model == "FULL_OPENCV" else 5)
    coefficients[: len(rest)] = rest
    return camera, distortion(coefficients)


def has_model(folder: Path) -> bool:
    """Whether a folder holds ``cameras`` and ``images``, both binary or both text."""
    return any(all((folder / f"{name}{end}").is_file() for name in ("cameras", "images")) for end in (".bin", ".txt"))


def read_model(folder: Path) -> Model:
    """The model in a folder; the binary one where both are there.

    Raises:
        FrogError: for a damaged file, an image of a camera that is not there, or a value that is out of range.
    """
    is_binary = (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()
    end, records = (".bin", _binary) if is_binary else (".txt", _text)
    files = {name: folder / f"{name}{end}" for name in _LINES}
    lenses = {index: _lens(files["cameras"], *lens) for index, *lens in records(files["cameras"])}
    images = {index: _posed(files["images"], *image) for index, *image in records(files["images"])}
    if not images:
        raise found_instead(folder, "a COLMAP model without an image", "one with poses")
    for image in images.values():
        if image.camera not in lenses:
            raise found_instead(folder, f"camera {image.camera} of {image.name} and no such camera", "one in cameras")
    points = list(islice(records(files["points3D"]), _MOST_POINTS)) if files["points3D"].is_file() else []
    taken = list(records(files["frames"])) if files["frames"].is_file() else []
    frames = {index: frame for frame, together in taken for index in together}
    is_rig = any(len(together) > 1 for _, together in taken)
    named = {images[index].name: frame for index, frame in frames.items() if is_rig and index in images}
    return Model(folder, lenses, list(images.values()), _usable(points, files["points3D"]), named)


class _Reader:
    """A binary file, of which nothing is read beyond its end."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file
        self._length = os.fstat(file.fileno()).st_size

    def take(self, layout: str) -> tuple[Any, ...]:
        """Values of ``struct``'s kinds."""
        length = struct.calcsize(f"<{layout}")
        if self._file.tell() + length > self._length:
            raise found_instead(self._path, "a file that is cut off", "a whole COLMAP model")
        return struct.unpack(f"<{layout}", self._file.read(length))

    def skip(self, length: int) -> None:
        """Passes over things of so many bytes, and the count of them before."""
        (count,) = self.take("Q")
        self.take(f"{min(count * length, self._length)}x")

    def text(self) -> str:
        """A name up to its zero byte, or the begin of one that is longer than a name may be."""
        characters = iter(lambda: self.take("c")[0], b"\0")
        return b"".join(islice(characters, _LONGEST_NAME + 1)).decode("utf-8", "surrogateescape")


def _binary(path: Path) -> Iterator[tuple[Any, ...]]:
    """The records of a file: of cameras the id, model, width, height and parameters; of images the id, pose, camera
    and name; of points the position; of frames the id and those of its images."""
    with regular_file(path, "a part of a COLMAP model").open("rb") as file:
        reader = _Reader(path, file)
        for _ in range(*reader.take("Q")):
            match path.stem:
                case "cameras":
                    index, model, width, height = reader.take("IiQQ")
                    if not 0 <= model < len(_MODELS):
                        raise found_instead(path, f"the camera model {model}", f"one of 0 to {len(_MODELS) - 1}")
                    name = _MODELS[model]
                    yield index, name, width, height, reader.take(f"{_PARAMETERS[name]}d")
                case "images":
                    index, *pose, camera = reader.take("I7dI")
                    name = reader.text()
                    reader.skip(24)  # the image's points
                    yield index, pose, camera, name
                case "points3D":
                    _, *position, _, _, _, _ = reader.take("Q3d3Bd")
                    reader.skip(8)  # where it was seen
                    yield tuple(position)
                case "frames":
                    frame, *_, count = reader.take("II7dI")
                    together = [reader.take("iIQ") for _ in range(count)]
                    yield frame, [index for kind, _, index in together if kind == _A_CAMERA]


def _text(path: Path) -> Iterator[tuple[Any, ...]]:
    """The same of a text file."""
    check_length(path, "a part of a COLMAP model")
    with path.open(encoding="utf-8", errors="surrogateescape") as file:
        for line in map(str.strip, file):
            if not line or line.startswith("#"):
                continue
            fields = line.split(maxsplit=9 if path.stem == "images" else -1)
            match path.stem, fields:
                case "cameras", [index, model, width, height, *values] if model in _PARAMETERS:
                    yield _whole(index, path), model, width, height, values
                case "images", [index, *pose, camera, name] if len(pose) == 7:
                    yield _whole(index, path), pose, _whole(camera, path), name
                    next(file, None)  # the image's points, which may be none
                case "points3D", [_, x, y, z, *_]:
                    yield x, y, z
                case "frames", [frame, *_] if len(fields) >= 10:
                    data = zip(fields[10::3], fields[12::3], strict=False)
                    yield _whole(frame, path), [_whole(index, path) for kind, index in data if kind == "CAMERA"]
                case _:
                    raise found_instead(path, f"the line {line[:60]!r}", _LINES[path.stem])


def _lens(path: Path, model: str, width: object, height: object, values: object) -> tuple[str, int, int, Float64s]:
    sides = size(np.array(width), path, "a camera's width"), size(np.array(height), path, "a camera's height")
    return model, *sides, numbers(np.array(values), (_PARAMETERS[model],), path, f"the parameters of a {model} camera")


def _posed(path: Path, stored: object, camera: int, name: str) -> PosedImage:
    values = numbers(np.array(stored), (7,), path, f"the pose of {name[:60]}")
    if not name or "\0" in name or len(name) > _LONGEST_NAME:
        raise found_instead(path, f"the image name {name[:60]!r}", f"one of 1 to {_LONGEST_NAME} characters")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = from_quaternion(values[:4], path, f"the pose of {name[:60]}"), values[4:]
    return PosedImage(name.replace("\\", "/"), camera, pose)


def _usable(points: list[tuple[Any, ...]], path: Path) -> Float64s:
    """(N, 3) points of those that are finite and within the limits."""
    try:
        array = np.array(points, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise found_instead(path, "a point that is not made of numbers", _LINES["points3D"]) from error
    return usable_points(array)


def _whole(text: str, path: Path) -> int:
    value = number(np.array(text), path, "a number")
    if value != round(value):
        raise found_instead(path, f"the number {text}", "a whole one")
    return round(value)
