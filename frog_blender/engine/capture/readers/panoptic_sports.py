"""PanopticSports as Dynamic 3D Gaussians has it: ``train_meta.json``, ``test_meta.json`` and ``ims``.

The lists are nested by time, then camera: ``fn`` (paths below ``ims``), ``k`` (3 x 3, pixels), ``w2c`` (4 x 4, world
to camera in OpenCV's axes), ``cam_id``; ``w`` and ``h`` are of all images. The cameras of ``test_meta.json`` are held
out. ``data`` in ``init_pt_cld.npz`` (optional) is (N, 6 or more): place, colour, and whether it belongs to what
moves. (JonathonLuiten/Dynamic3DGaussians, train.py.)
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead
from ...io.numpy_files import read_npz
from ..camera import Camera
from ..capture import MAX_IMAGES, Capture, Shot
from ..video import image_size, image_turns
from .assembly import with_points
from .checks import MAX_COORDINATE, check_images, frame_span, number, pinhole, read_json, rigid, rotation, size
from .footage import fitted

_TRAIN, _TEST, _IMAGES, _POINTS = "train_meta.json", "test_meta.json", "ims", "init_pt_cld.npz"
_KEYS = ("fn", "k", "w2c", "cam_id")
_MOST_POINTS = 10_000_000
_LONGEST_NAME = 1000  # characters


@dataclass(frozen=True, eq=False)
class _Entry:
    """A listed image that exists; ``key`` is equal for images of one standing camera."""

    frame: int
    name: str
    image: Path
    camera: Camera
    key: tuple[object, ...]


def matches(path: Path) -> bool:
    """True if the folder holds ``train_meta.json``."""
    return (path / _TRAIN).is_file()


def read(path: Path) -> Capture:
    """Open a PanopticSports folder.

    Raises:
        FrogError: if no listed image exists, or a value cannot be used.
    """
    warnings: list[str] = []
    train = _entries(path, path / _TRAIN, warnings)
    if not train:
        raise found_instead(path / _TRAIN, "images of which none exists", f"them in {_IMAGES}")
    test = _entries(path, path / _TEST, warnings) if (path / _TEST).is_file() else []
    entries = [*train, *test]
    names = _names(entries)
    first = {name: index for index, name in reversed(list(enumerate(names)))}
    order = sorted(first, key=first.__getitem__)
    place = {name: index for index, name in enumerate(order)}
    cameras = []
    for name in order:
        entry = entries[first[name]]
        size_and_turns = image_size(entry.image), image_turns(entry.image)
        camera, _ = fitted((entry.camera, None), *size_and_turns, entry.image)
        cameras.append(replace(camera, name=name))
    shots: dict[tuple[int, int], Shot] = {}
    for name, entry in zip(names, entries, strict=True):
        shots.setdefault((place[name], entry.frame), Shot(place[name], entry.frame, entry.image, 0))
    capture = Capture(
        path=path,
        format="panoptic_sports",
        cameras=tuple(cameras),
        distortions=(None,) * len(cameras),
        shots=tuple(shots.values()),
        frame_count=max(entry.frame for entry in entries) + 1,
        test_cameras=frozenset(names[len(train) :]) - frozenset(names[: len(train)]),
        warnings=tuple(warnings),
    )
    return with_points(capture, _points(path / _POINTS))


def _entries(path: Path, file: Path, warnings: list[str]) -> list[_Entry]:
    """The listed images that exist."""
    data = read_json(file)
    width, height = (size(data.get(key), file, key) for key in ("w", "h"))
    found, listed = [], 0
    for frame, where, (name, matrix, pose, camera) in _rows(data, file):
        listed += 1
        image = Path(os.path.normpath(path / _IMAGES / name.replace("\\", "/")))
        if not image.is_relative_to(os.path.normpath(path / _IMAGES)):
            raise FrogError(f"{file}: the image {name!r} lies outside {_IMAGES}, expected one inside.")
        if not image.is_file():
            continue
        intrinsics = pinhole(matrix, file, f"k of {where}")
        world_to_camera = rigid(pose, file, f"w2c of {where}")
        exact = np.eye(4)
        exact[:3, :3] = rotation(world_to_camera[:3, :3], file, f"w2c of {where}")
        exact[:3, 3] = world_to_camera[:3, 3]
        key = (camera, intrinsics.tobytes(), exact.tobytes())
        found.append(_Entry(frame, camera, image, Camera(camera, width, height, intrinsics, exact), key))
    if found and len(found) < listed:
        warnings.append(f"{file}: {listed - len(found)} of {listed} listed images are missing and left out.")
    check_images(path, len(found))
    return found


def _rows(data: dict[str, object], file: Path) -> Iterator[tuple[int, str, tuple[str, object, object, str]]]:
    """Frame, place in words, and the values of each image."""
    lists = [_list(data.get(key), key, file) for key in _KEYS]
    times = len(lists[0])
    if not times or any(len(each) != times for each in lists):
        raise found_instead(file, "lists fn, k, w2c and cam_id of different lengths", "the same times in each")
    frame_span(0, times - 1, file, "times")
    total = 0
    for frame, each in enumerate(zip(*lists, strict=True)):
        row = [_list(values, f"{key} at time {frame}", file) for key, values in zip(_KEYS, each, strict=True)]
        if len({len(values) for values in row}) > 1:
            raise found_instead(file, f"different numbers of cameras at time {frame}", "the same in fn, k, w2c, cam_id")
        total += len(row[0])
        if total > MAX_IMAGES:
            raise found_instead(file, f"more than {MAX_IMAGES:,} images", "fewer")
        for name, matrix, pose, camera in zip(*row, strict=True):
            where = f"camera {camera} at time {frame}"
            if not isinstance(name, str) or not name or "\0" in name or len(name) > _LONGEST_NAME:
                raise found_instead(file, f"no name of the image of {where}", "a path below ims")
            number_of_camera = number(camera, file, "cam_id")
            yield frame, where, (name, matrix, pose, f"{number_of_camera:g}")


def _list(value: object, what: str, file: Path) -> list[object]:
    if not isinstance(value, list):
        raise found_instead(file, f"no list {what}", "lists fn, k, w2c and cam_id, nested by time and camera")
    return value


def _names(entries: list[_Entry]) -> list[str]:
    """The name of each image's camera: its id where it stands; else id and time, an image being a camera."""
    keys: dict[str, set[object]] = {}
    for entry in entries:
        keys.setdefault(entry.name, set()).add(entry.key)
    if all(len(of_camera) == 1 for of_camera in keys.values()):
        return [entry.name for entry in entries]
    return [f"{entry.name}_{entry.frame:05d}" for entry in entries]


def _points(file: Path) -> Float64s | None:
    """(N, 3) points in world units, None where the capture has none."""
    if not file.is_file():
        return None

    def wanted(name: str, shape: tuple[int, ...]) -> None:
        if name == "data" and (len(shape) != 2 or shape[1] < 3):
            raise found_instead(file, f"data of shape {shape}", "points of shape (N, 7)")

    arrays = read_npz(file, "points (init_pt_cld.npz)", wanted, 7 * _MOST_POINTS)
    if "data" not in arrays:
        raise found_instead(file, f"arrays {', '.join(arrays) or 'none'}", "data")
    with np.errstate(invalid="ignore"):  # some NaN warn when they are converted
        points: Float64s = arrays["data"][:, :3].astype(np.float64)
    usable: Float64s = points[(np.abs(points) <= MAX_COORDINATE).all(axis=1)]
    return usable
