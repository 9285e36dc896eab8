"""Turns that a file asks of whoever shows its images: EXIF's orientation of photographs, and rotations of films.

A camera that was calibrated in images as they are stored is turned with them.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import BinaryIO

import numpy as np

from ..arrays import Float64s, ImageArray
from .camera import Camera
from .capture import Distortion
from .image_header import PNG_START, jpeg_segments

UPRIGHT = 1
"""EXIF's orientation of an image that is shown as it is stored."""
_EXIF_MARKER, _EXIF_START = 0xE1, b"Exif\0\0"
_ORIENTATION_TAG, _SHORT = 0x0112, 3
_MAX_ENTRIES, _MAX_CHUNKS, _MAX_EXIF = 1000, 1000, 2**16
# Quarter turns clockwise, after which those of _MIRRORED are mirrored left to right.
_TURNS = {1: 0, 2: 0, 3: 2, 4: 2, 5: 1, 6: 1, 7: 3, 8: 3}
_MIRRORED = frozenset({2, 4, 5, 7})
_MAX_TURNED_COEFFICIENTS = 12  # beyond them OpenCV's model tilts the sensor


def orientation_in_header(file: BinaryIO) -> int:
    """EXIF's orientation (1 to 8) of an open JPEG, PNG or WebP; 1 where the file names none."""
    start = file.read(12)
    file.seek(0)
    try:
        if start.startswith(b"\xff\xd8"):
            exif = _jpeg_exif(file)
        elif start.startswith(PNG_START):
            exif = _png_exif(file)
        elif start[:4] == b"RIFF" and start[8:] == b"WEBP":
            exif = _webp_exif(file)
        else:
            return UPRIGHT
        return _orientation(exif.removeprefix(_EXIF_START))
    except struct.error:
        return UPRIGHT


def is_mirrored(orientation: int) -> bool:
    """Whether the image is shown mirrored, as no camera took it."""
    return orientation in _MIRRORED


def quarter_turns(orientation: int) -> int:
    """Quarter turns clockwise by which a stored image is shown."""
    return _TURNS.get(orientation, 0)


def oriented(image: ImageArray, orientation: int) -> ImageArray:
    """An image (H, W) or (H, W, C) as EXIF's orientation says that it is shown."""
    image = turned(image, quarter_turns(orientation))
    return np.ascontiguousarray(image[:, ::-1]) if is_mirrored(orientation) else image


def turned(image: ImageArray, turns: int) -> ImageArray:
    """An image (H, W) or (H, W, C) after quarter turns clockwise."""
    return np.ascontiguousarray(np.rot90(image, -turns)) if turns % 4 else image


def turned_size(size: tuple[int, int], turns: int) -> tuple[int, int]:
    """(width, height) after quarter turns."""
    return (size[1], size[0]) if turns % 2 else size


def turned_camera(camera: Camera, distortion: Distortion | None, turns: int) -> tuple[Camera, Distortion | None] | None:
    """The camera whose images are those of ``camera`` after quarter turns clockwise, and its lens.

    None where OpenCV's model cannot say it: skewed pixels, and tilted sensors.
    """
    turns %= 4
    if turns and distortion is not None and not _turns_easily(distortion):
        return None
    for _ in range(turns):
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
        # x' = H - y and y' = x, in pixels and along the camera's axes
        quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        pose = camera.with_pose(quarter @ camera.world_to_camera[:3])
        lens = np.array([[fy, 0.0, camera.height - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]])
        camera = replace(pose, width=camera.height, height=camera.width, intrinsics=lens)
        distortion = None if distortion is None else Distortion(_quarter_turned(distortion.coefficients))
    return camera, distortion


def _turns_easily(distortion: Distortion) -> bool:
    return not distortion.skew and not np.any(distortion.coefficients[_MAX_TURNED_COEFFICIENTS:])


def _quarter_turned(coefficients: Float64s) -> Float64s:
    """The tangential and thin-prism terms where x' = -y and y' = x; radial terms stay."""
    found = coefficients.copy()
    found[2], found[3] = coefficients[3], -coefficients[2]
    if len(found) >= _MAX_TURNED_COEFFICIENTS:
        found[8:10], found[10:12] = -coefficients[10:12], coefficients[8:10]
    return found


def _jpeg_exif(file: BinaryIO) -> bytes:
    file.seek(2)
    for marker, length in jpeg_segments(file):
        if marker == _EXIF_MARKER:
            content = file.read(length)
            if content.startswith(_EXIF_START):
                return content
    return b""


def _png_exif(file: BinaryIO) -> bytes:
    place = len(PNG_START)
    for _ in range(_MAX_CHUNKS):
        file.seek(place)
        size, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"eXIf":
            return file.read(min(size, _MAX_EXIF))
        if kind == b"IDAT":  # what follows the image is not looked for: it may have many chunks
            break
        place += 12 + size
    return b""


def _webp_exif(file: BinaryIO) -> bytes:
    place = 12
    for _ in range(_MAX_CHUNKS):
        file.seek(place)
        kind, size = struct.unpack("<4sI", file.read(8))
        if kind == b"EXIF":
            return file.read(min(size, _MAX_EXIF))
        place += 8 + size + size % 2
    return b""


def _orientation(exif: bytes) -> int:
    """The orientation that a TIFF header and its first directory name."""
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None:
        return UPRIGHT
    place = struct.unpack_from(f"{order}I", exif, 4)[0]
    count = min(struct.unpack_from(f"{order}H", exif, place)[0], _MAX_ENTRIES)
    for entry in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", exif, place + 2 + 12 * entry)
        if (tag, kind) == (_ORIENTATION_TAG, _SHORT):
            value: int = struct.unpack_from(f"{order}H", exif, place + 2 + 12 * entry + 8)[0]
            return value if value in _TURNS else UPRIGHT
    return UPRIGHT
