"""COLMAP's sparse model, binary or text: ``cameras``, ``images``, ``points3D`` and, from 3.12 on, ``frames``.

Poses take world to camera in OpenCV's axes: a quaternion w x y z and a translation. Pixel centres lie at +0.5, as in
this project. Counts are little-endian 64-bit numbers, checked against the file's size before anything is read for them.
(colmap/colmap, src/colmap/scene/reconstruction_io_binary.cc and reconstruction_io_text.cc; src/colmap/sensor/models.h.)

``rigs`` is not needed: ``images`` says every image's own pose. ``frames`` says which images were taken at one time.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead
from ...io.regular_file import regular_file
from ..camera import Camera
from ..capture import MAX_IMAGES, Distortion
from ..lenses import FISHEYE, FOV, THIN_PRISM_FISHEYE
from .checks import MAX_COORDINATE, check_length, number, numbers, size
from .geometry import distortion, from_quaternion, intrinsics, through_lens

_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
_PARAMETERS = dict(_MODELS.values())
_ONE_FOCAL = frozenset({"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"})
_ONE_FOCAL_FISHEYE = "SIMPLE_FISHEYE"
_WITHOUT_READER = frozenset({"RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM", "EQUIRECTANGULAR"})
_MOST_POINTS = 2_000_000

_LONGEST_NAME = 1000  # characters
_A_CAMERA = 0  # kind of sensor


@dataclass(frozen=True, eq=False)
class PosedImage:
    """An image of the model.

    Attributes:
        name: as COLMAP was given it: a path below its folder of images, with slashes.
        camera: id in ``Model.lenses``.
        rotation: (3, 3) world to camera.
        translation: (3,) world units.
    """

    name: str
    camera: int
    rotation: Float64s
    translation: Float64s


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
            FrogError: for a lens model without a reader.
        """
        model, width, height, values = self.lenses[image.camera]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = image.rotation, image.translation
        return lens_camera(Camera(name, width, height, np.eye(3), pose), model, values, self.folder)


def lens_camera(camera: Camera, model: str, values: Float64s, path: Path) -> tuple[Camera, Distortion | None]:
    """A camera with the K and distortion of one of COLMAP's camera models.

    Raises:
        FrogError: for a lens model without a reader, or a focal length that is not positive.
    """
    if model in _WITHOUT_READER:
        raise found_instead(
            path,
            f"cameras of the model {model}",
            "PINHOLE, OPENCV or OPENCV_FISHEYE (COLMAP's image_undistorter writes PINHOLE)",
        )
    one = model in _ONE_FOCAL or model == _ONE_FOCAL_FISHEYE
    focal_x, focal_y, center_x, center_y, *rest = [values[0], *values] if one else values
    if min(focal_x, focal_y) <= 0:
        raise found_instead(path, f"a focal length of {min(focal_x, focal_y):g}", "a positive one")
    filled = Camera(
        camera.name,
        camera.width,
        camera.height,
        intrinsics(focal_x, focal_y, center_x, center_y),
        camera.world_to_camera,
    )
    if model == "FOV":
        if not 1e-3 <= rest[0] <= 3.1:
            raise found_instead(path, f"omega = {rest[0]:g} in a FOV camera", "radians between 0 and pi")
        return through_lens(filled, FOV, np.array(rest), path)
    if model == "THIN_PRISM_FISHEYE":
        return through_lens(filled, THIN_PRISM_FISHEYE, np.array(rest), path)
    if model.endswith("FISHEYE"):
        return through_lens(filled, FISHEYE, np.array([*rest, 0.0, 0.0, 0.0, 0.0][:4]), path)
    coefficients = np.zeros(8 if model == "FULL_OPENCV" else 5)
    coefficients[: len(rest)] = rest
    return filled, distortion(coefficients)


def has_model(folder: Path) -> bool:
    """Whether a folder holds ``cameras`` and ``images``, both binary or both text."""
    return any(all((folder / f"{name}{end}").is_file() for name in ("cameras", "images")) for end in (".bin", ".txt"))


def read_model(folder: Path) -> Model:
    """The model in a folder; the binary one where both are there.

    Raises:
        FrogError: for a damaged file, an image of a camera that is not there, or a value that is out of range.
    """
    binary = (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()
    if binary:
        lenses = dict(_binary_cameras(folder / "cameras.bin"))
        listed = dict(_binary_images(folder / "images.bin"))
        points = _binary_points(folder / "points3D.bin") if (folder / "points3D.bin").is_file() else np.zeros((0, 3))
        frames = _binary_frames(folder / "frames.bin") if (folder / "frames.bin").is_file() else {}
    else:
        lenses = dict(_text_cameras(folder / "cameras.txt"))
        listed = dict(_text_images(folder / "images.txt"))
        points = _text_points(folder / "points3D.txt") if (folder / "points3D.txt").is_file() else np.zeros((0, 3))
        frames = _text_frames(folder / "frames.txt") if (folder / "frames.txt").is_file() else {}
    if not listed:
        raise found_instead(folder, "a COLMAP model without an image", "one with poses")
    for image in listed.values():
        if image.camera not in lenses:
            raise found_instead(folder, f"camera {image.camera} of {image.name} and no such camera", "one in cameras")
    named = {listed[index].name: frame for index, frame in frames.items() if index in listed}
    return Model(folder, lenses, list(listed.values()), points, named)


class _Reader:
    """A binary file, of which nothing is read beyond its end."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.path, self._file = path, file
        self._left = os.fstat(file.fileno()).st_size

    def take(self, layout: struct.Struct) -> tuple[int | float, ...]:
        self._reserve(layout.size)
        return layout.unpack(self._file.read(layout.size))

    def count(self, each: int, what: str) -> int:
        """A 64-bit count of things of at least ``each`` bytes that follow."""
        (count,) = self.take(_COUNT)
        if count * each > self._left:
            raise found_instead(self.path, f"{count:,} {what} in a file with {self._left:,} bytes left", "a whole file")
        return int(count)

    def doubles(self, count: int) -> Float64s:
        self._reserve(8 * count)
        return np.frombuffer(self._file.read(8 * count), "<f8").astype(np.float64)

    def skip(self, length: int) -> None:
        self._reserve(length)
        self._file.seek(length, io.SEEK_CUR)

    def text(self) -> str:
        """A name up to its zero byte."""
        parts: list[bytes] = []
        while len(parts) < _LONGEST_NAME:
            self._reserve(1)
            byte = self._file.read(1)
            if byte == b"\0":
                return b"".join(parts).decode("utf-8", "surrogateescape")
            parts.append(byte)
        raise found_instead(self.path, f"a name of more than {_LONGEST_NAME} characters", "the name of an image")

    def _reserve(self, length: int) -> None:
        self._left -= length
        if self._left < 0:
            raise found_instead(self.path, "a file that is cut off", "a whole COLMAP model")


_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I7dI")
_POINT = struct.Struct("<Q3d3BdQ")
_FRAME = struct.Struct("<II7dI")
_DATUM = struct.Struct("<iIQ")


def _binary_cameras(path: Path) -> Iterator[tuple[int, tuple[str, int, int, Float64s]]]:
    with _opened(path) as file:
        reader = _Reader(path, file)
        for _ in range(reader.count(_CAMERA.size, "cameras")):
            index, model, width, height = reader.take(_CAMERA)
            if model not in _MODELS:
                raise found_instead(path, f"the camera model {model}", f"one of 0 to {max(_MODELS)}")
            name, count = _MODELS[int(model)]
            yield int(index), _checked_lens(name, width, height, reader.doubles(count), path)


def _binary_images(path: Path) -> Iterator[tuple[int, PosedImage]]:
    with _opened(path) as file:
        reader = _Reader(path, file)
        count = reader.count(_IMAGE.size, "images")
        if count > MAX_IMAGES:
            raise found_instead(path, f"{count:,} images", f"at most {MAX_IMAGES:,}")
        for _ in range(count):
            index, *pose, camera = reader.take(_IMAGE)
            name = reader.text()
            reader.skip(24 * reader.count(24, "points of an image"))
            yield int(index), _posed(name, int(camera), pose, path)


def _binary_points(path: Path) -> Float64s:
    """(N, 3), at most the first ``_MOST_POINTS``."""
    points = []
    with _opened(path) as file:
        reader = _Reader(path, file)
        for _ in range(min(reader.count(_POINT.size, "points"), _MOST_POINTS)):
            _, x, y, z, *_, track = reader.take(_POINT)
            reader.skip(8 * int(track))
            points.append((x, y, z))
    return _usable(points)


def _binary_frames(path: Path) -> dict[int, int]:
    """The frame of each image by the image's id, of rigs with several cameras."""
    frames: dict[int, int] = {}
    several = False
    with _opened(path) as file:
        reader = _Reader(path, file)
        for _ in range(reader.count(_FRAME.size, "frames")):
            frame, *_, data = reader.take(_FRAME)
            images = []
            for _ in range(int(data)):
                kind, _, index = reader.take(_DATUM)
                if kind == _A_CAMERA:
                    images.append(int(index))
            several |= len(images) > 1
            frames |= dict.fromkeys(images, int(frame))
    return frames if several else {}


def _text_cameras(path: Path) -> Iterator[tuple[int, tuple[str, int, int, Float64s]]]:
    for line in _lines(path):
        if not line or line.startswith("#"):
            continue
        fields = line.split()
        if len(fields) < 4 or fields[1] not in _PARAMETERS:
            raise found_instead(path, f"the line {line[:60]!r}", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS of a known model")
        values = numbers(fields[4:], (_PARAMETERS[fields[1]],), path, f"the parameters of camera {fields[0]}")
        yield _whole(fields[0], path), _checked_lens(fields[1], fields[2], fields[3], values, path)


def _text_images(path: Path) -> Iterator[tuple[int, PosedImage]]:
    lines = _lines(path)
    for line in lines:
        if not line or line.startswith("#"):
            continue
        fields = line.split(maxsplit=9)
        if len(fields) < 10:
            raise found_instead(path, f"the line {line[:60]!r}", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        yield _whole(fields[0], path), _posed(fields[9], _whole(fields[8], path), fields[1:8], path)
        next(lines, None)  # the image's points, which may be none


def _text_points(path: Path) -> Float64s:
    points = []
    for line in _lines(path):
        if not line or line.startswith("#"):
            continue
        points.append(numbers(line.split(maxsplit=4)[1:4], (3,), path, "a point", most=np.inf))
        if len(points) == _MOST_POINTS:
            break
    return _usable(points)


def _text_frames(path: Path) -> dict[int, int]:
    frames: dict[int, int] = {}
    several = False
    for line in _lines(path):
        if not line or line.startswith("#"):
            continue
        fields = line.split()
        data = fields[10:]
        images = [_whole(data[i + 2], path) for i in range(0, len(data) - 2, 3) if data[i] == "CAMERA"]
        several |= len(images) > 1
        frames |= dict.fromkeys(images, _whole(fields[0], path))
    return frames if several else {}


def _checked_lens(
    model: str, width: object, height: object, values: Float64s, path: Path
) -> tuple[str, int, int, Float64s]:
    what = f"the parameters of a {model} camera"
    sides = size(width, path, "a camera's width"), size(height, path, "a camera's height")
    return model, *sides, numbers(values, values.shape, path, what)


def _posed(name: str, camera: int, pose: object, path: Path) -> PosedImage:
    values = numbers(pose, (7,), path, f"the pose of {name[:60]}")
    if not name or "\0" in name or len(name) > _LONGEST_NAME:
        raise found_instead(path, f"the image name {name[:60]!r}", f"one of 1 to {_LONGEST_NAME} characters")
    turn = from_quaternion(values[:4], path, f"the pose of {name[:60]}")
    return PosedImage(name.replace("\\", "/"), camera, turn, values[4:])


def _usable(points: object) -> Float64s:
    """(N, 3) points of those that are finite and within the limits."""
    array = np.array(points, dtype=np.float64).reshape(-1, 3)
    usable: Float64s = array[(np.abs(array) <= MAX_COORDINATE).all(axis=1)]
    return usable


def _whole(text: str, path: Path) -> int:
    value = number(text, path, "a number")
    if value != round(value):
        raise found_instead(path, f"the number {text}", "a whole one")
    return round(value)


def _opened(path: Path) -> BinaryIO:
    try:
        return regular_file(path, "a part of a COLMAP model").open("rb")
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "a COLMAP model") from error


def _lines(path: Path) -> Iterator[str]:
    """The lines of a text file, without blanks around them."""
    check_length(path, "a part of a COLMAP model")
    try:
        with path.open(encoding="utf-8", errors="surrogateescape") as file:
            for line in file:
                yield line.strip()
    except OSError as error:
        raise FrogError(f"{path}: the file cannot be read ({error.strerror}).") from error
