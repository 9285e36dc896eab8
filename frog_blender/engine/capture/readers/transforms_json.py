"""Pictures with ``transforms.json`` (nerfstudio) or ``transforms_train.json`` (D-NeRF, Blender).

Each listed picture has its own pose: camera-to-world in OpenGL's axes (x right, y up, looking along -z). Intrinsics
and distortion stand at the top level or with a picture, whose own values win. ``time`` is optional: without it the
pictures follow one another in the order of the list.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FrogError, found_instead
from ..camera import Camera
from ..capture import Capture, Distortion, Shot
from ..picture_size import picture_size
from ..video import with_ending
from .checks import number, numbers, pose, read_json, rotation, size

_SINGLE = "transforms.json"
_TRAIN = "transforms_train.json"
_HELD_OUT = ("transforms_val.json", "transforms_test.json")
_HOLDOUT_EVERY = 8


@dataclass(frozen=True)
class _Entry:
    """A listed picture that exists.

    Attributes:
        file: the list.
        top, own: what it says of all its pictures, and of this one.
        picture: the file.
        place: in the list, missing pictures counted.
    """

    file: Path
    top: dict[str, Any]
    own: dict[str, Any]
    picture: Path
    place: int


def matches(path: Path) -> bool:
    """True if the folder holds ``transforms.json`` or ``transforms_train.json``."""
    return (path / _SINGLE).is_file() or (path / _TRAIN).is_file()


def read(path: Path) -> Capture:
    """Open a folder of posed pictures.

    Every eighth moment of a single moving camera is held out; with separate lists, the test and val pictures are.

    Raises:
        FrogError: if no listed picture exists, a path leads outside the folder, or a value cannot be used.
    """
    has_splits = not (path / _SINGLE).is_file()
    files = [path / _SINGLE]
    if has_splits:
        files = [path / _TRAIN, *(path / name for name in _HELD_OUT if (path / name).is_file())]
    entries: list[_Entry] = []
    warnings: list[str] = []
    for file in files:
        found, listed = _find_pictures(path, file)
        if not found and file == files[0]:
            raise found_instead(file, f"{listed} listed pictures of which none exists", "the pictures beside it")
        if len(found) < listed:
            warnings.append(f"{file}: {listed - len(found)} of {listed} listed pictures are missing and left out.")
        entries += found
    times = _times(entries)
    order = {time: rank for rank, time in enumerate(sorted(set(times)))}
    names = _names(path, [entry.picture for entry in entries])
    cameras, distortions, shots = [], [], []
    for index, (entry, time) in enumerate(zip(entries, times, strict=True)):
        camera, distortion = _camera(names[index], entry, picture_size(entry.picture))
        cameras.append(camera)
        distortions.append(distortion)
        shots.append(Shot(index, order[time], entry.picture, 0))
    rate = entries[0].top.get("fps", 30.0)
    capture = Capture(
        path=path,
        format="transforms",
        cameras=tuple(cameras),
        distortions=tuple(distortions),
        shots=tuple(shots),
        frame_count=len(order),
        frames_per_second=number(rate, files[0], "fps", positive=True),
        test_cameras=frozenset(names[i] for i, entry in enumerate(entries) if entry.file != files[0]),
        # Pictures with splits are rendered over white, as everyone who publishes numbers on them does.
        background=(1.0, 1.0, 1.0) if has_splits else (0.0, 0.0, 0.0),
        warnings=tuple(warnings),
    )
    is_one_camera = len(order) == len(shots) and capture.frame_count > _HOLDOUT_EVERY // 2
    return capture.with_holdout(_HOLDOUT_EVERY) if is_one_camera and not has_splits else capture


def pictures_by_camera(path: Path) -> dict[str, Path]:
    """The picture of each camera by its name, of those that exist; nothing is decoded.

    Raises:
        FrogError: for a list that cannot be used.
    """
    files = [path / name for name in (_TRAIN, *_HELD_OUT) if (path / name).is_file()]
    files = [path / _SINGLE] if (path / _SINGLE).is_file() else files
    pictures = [entry.picture for file in files for entry in _find_pictures(path, file)[0]]
    return dict(zip(_names(path, pictures), pictures, strict=True))


def _find_pictures(folder: Path, file: Path) -> tuple[list[_Entry], int]:
    """The entries whose pictures exist, and how many are listed."""
    top = read_json(file)
    frames = top.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise found_instead(file, "no list of frames", '"frames": [{"file_path": ..., "transform_matrix": ...}, ...]')
    found = []
    for place, frame in enumerate(frames):
        name = frame.get("file_path")
        if not isinstance(name, str) or not name or "\0" in name:
            raise found_instead(file, "a frame without a file_path", "a file_path for each frame")
        inside = os.path.normpath(os.path.join(folder, name.replace("\\", "/")))
        if not Path(os.path.abspath(inside)).is_relative_to(os.path.abspath(folder)):
            raise FrogError(f"{file}: the picture {name!r} lies outside the capture's folder, expected one inside.")
        picture = Path(inside) if os.path.isfile(inside) else with_ending(Path(inside))
        if picture is not None:
            found.append(_Entry(file, top, frame, picture, place))
    return found, len(frames)


def _times(entries: list[_Entry]) -> list[float]:
    """A time for each picture: its own where all have one, else its place in its list."""
    if all(entry.own.get("time") is not None for entry in entries):
        # Rounded, so that 1/3 written with 6 digits by one list and 16 by another is one moment.
        return [round(number(entry.own["time"], entry.file, "time"), 6) for entry in entries]
    return [float(entry.place) for entry in entries]


def _names(folder: Path, pictures: list[Path]) -> list[str]:
    """A unique camera name for each picture: the file's name, with its folders where that is not unique."""
    stems = [picture.stem for picture in pictures]
    if len(set(stems)) == len(stems):
        return stems
    names = [Path(os.path.relpath(picture, folder)).as_posix() for picture in pictures]
    return names if len(set(names)) == len(names) else [f"{name}#{index}" for index, name in enumerate(names)]


def _camera(name: str, entry: _Entry, real: tuple[int, int]) -> tuple[Camera, Distortion | None]:
    """The OpenCV camera of one picture, at the picture's real (width, height)."""
    file, top, own = entry.file, entry.top, entry.own
    both = {**top, **own}
    model = str(both.get("camera_model", "OPENCV")).upper()
    if "FISHEYE" in model or model in ("EQUIRECTANGULAR", "ORTHOPHOTO") or both.get("is_fisheye"):
        raise found_instead(file, f"the camera model {model}", "a perspective camera (PINHOLE or OPENCV)")
    width = size(both.get("w", real[0]), file, "w")
    height = size(both.get("h", real[1]), file, "h")
    if abs(width * real[1] / (height * real[0]) - 1) > 0.02:
        found = f"w x h = {width} x {height} for {entry.picture.name} of {real[0]} x {real[1]} pixels"
        raise found_instead(file, found, "the same proportions")
    focal_x = _focal(file, top, own, "x", width)
    if focal_x is None:
        raise found_instead(file, "no focal length", "fl_x or camera_angle_x")
    focal_y = _focal(file, top, own, "y", height)
    center_x = number(both.get("cx", width / 2), file, "cx")
    center_y = number(both.get("cy", height / 2), file, "cy")
    intrinsics = np.array([[focal_x, 0, center_x], [0, focal_y or focal_x, center_y], [0, 0, 1.0]])
    matrix = numbers(own.get("transform_matrix"), (4, 4), file, f"transform_matrix of {name}")
    camera_to_world = rotation(matrix[:3, :3], file, f"the transform_matrix of {name}") @ np.diag([1.0, -1.0, -1.0])
    coefficients = np.array([number(both.get(key, 0.0), file, key) for key in ("k1", "k2", "p1", "p2", "k3")])
    camera = Camera(name, width, height, intrinsics, pose(camera_to_world.T, matrix[:3, 3]))
    if (width, height) != real:
        camera = camera.resized(*real)
    return camera, Distortion(coefficients) if np.any(coefficients) else None


def _focal(file: Path, top: dict[str, Any], own: dict[str, Any], axis: str, pixels: int) -> float | None:
    """Focal length in pixels along x or y: the picture's own before the list's, fl before the angle."""
    for source in (own, top):
        if source.get(f"fl_{axis}") is not None:
            return number(source[f"fl_{axis}"], file, f"fl_{axis}", positive=True)
        if axis == "y" and any(source.get(key) is not None for key in ("fl_x", "camera_angle_x")) and source is own:
            return None  # square pixels: do not mix a picture's own fl_x with the list's fl_y
        if source.get(f"camera_angle_{axis}") is not None:
            angle = number(source[f"camera_angle_{axis}"], file, f"camera_angle_{axis}", positive=True)
            if angle >= np.pi:
                raise found_instead(file, f"camera_angle_{axis} = {angle:g}", "less than pi (radians)")
            return pixels / (2 * np.tan(angle / 2))
    return None
