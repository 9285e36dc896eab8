"""The files that a calibration writes and readers take: never over one that is there.

``cameras_opencv.json`` holds standing cameras, ``transforms.json`` the posed images of a moving one. What is in use has
the name that readers look for. What is set aside keeps its name with ``_given`` or ``_found`` at its end, and a number
where another file has that name. No content is ever lost.
"""

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import FrogError, UsageError, in_words
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ..readers import layout_of
from ..synchronization.films import Film
from ..video import IMAGE_SUFFIXES
from .model import Calibration, MovingCamera
from .sequences import ImageSequence

_CAMERAS = "cameras_opencv.json"
_FOUND = {_CAMERAS: "cameras_found", "transforms.json": "transforms_found"}
"""What is called until it is in use, without its ending, what readers take under these names."""
_SOONER = ("poses_bounds.npy", "transforms.json", "transforms_train.json", "dataset.json", "cameras_parameters.txt")
"""What readers take sooner than ``cameras_opencv.json``; ``poses_bounds.npy`` sooner than the others as well."""
_GIVEN = {name: f"{Path(name).stem.removesuffix('_opencv')}_given" for name in (*_SOONER, _CAMERAS)}
"""Of each what it is called once it is set aside, without its ending."""
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV's axes to OpenGL's
_FRAMES_PER_SECOND = 30.0


def write_cameras(folder: Path, calibration: Calibration, films: Sequence[Film]) -> Path:
    """Writes standing cameras, with each film's clock and path, and returns the file.

    Beside a calibration that was given it is ``cameras_found.json``, or that with a number, unless a file of that name
    holds the same.

    Raises:
        FrogError: if it cannot be written.
    """
    content = _plain(folder, calibration, films)
    folder.mkdir(parents=True, exist_ok=True)
    return _written(folder / _CAMERAS, content)


def write_transforms(folder: Path, sequence: ImageSequence, camera: MovingCamera) -> Path:
    """Writes the list of a sequence's posed images that every reader of captures knows, and returns the file.

    nerfstudio's list: camera to world in OpenGL's axes, and a time for each image if it is known.

    Raises:
        FrogError: if it cannot be written.
    """
    times = sequence.times
    frames = []
    for image, pose in zip(camera.placed, camera.poses, strict=True):
        matrix = np.linalg.inv(camera.lens.camera("", pose).world_to_camera) @ _FLIP
        path = sequence.images[image].resolve().relative_to(folder.resolve())
        frame: JsonObject = {"file_path": path.as_posix(), "transform_matrix": matrix.tolist()}
        frames.append(frame if times is None else frame | {"time": times[image]})
    lens, span = camera.lens, max(times) - min(times) if times else 0.0
    rate = (len(sequence.images) - 1) / span if span > 0 else _FRAMES_PER_SECOND
    size = {"camera_model": "OPENCV", "w": lens.width, "h": lens.height, "fl_x": lens.focal, "fl_y": lens.focal}
    middle = {"cx": lens.width / 2, "cy": lens.height / 2, "k1": lens.k1, "k2": lens.k2, "p1": 0.0, "p2": 0.0}
    return _written(folder / "transforms.json", size | middle | {"frames": frames, "fps": rate})


def _written(used: Path, plain: JsonObject) -> Path:
    sooner = [used] if os.path.lexists(used) or not is_calibrated(used.parent) else []
    return _kept(used, _FOUND[used.name], json.dumps(plain, indent=1).encode(), sooner)


def is_calibrated(folder: Path) -> bool:
    """Whether a reader knows this very folder as a capture already, whatever lies in the folders below it."""
    try:
        return layout_of(folder) is not None
    except FrogError:
        return False


def _kept(used: Path, stem: str, content: bytes, sooner: Sequence[Path] = ()) -> Path:
    """The file that holds the content already, or the first name that is free, which gets it.

    Names are those in ``sooner``, the stem beside ``used`` and with its ending, and that with a number.
    """
    numbered = (used.with_name(f"{stem}{'' if count < 2 else f'_{count}'}{used.suffix}") for count in range(1, 1000))
    paths = [*sooner, *numbered]
    for path in paths:
        if path.is_file() and _content(path) == content:
            return path
    free = next(path for path in paths if not os.path.lexists(path))
    write_atomically(free, content)
    return free


def found_beside(folder: Path) -> Path | None:
    """The newest calibration that was found and is not in use; None where there is none. FrogError if unreadable."""
    return _newest(folder)[0]


def use_found(folder: Path) -> tuple[Path, list[Path]]:
    """Makes the newest found calibration the one in use; returns its file, and those that keep what was in use before.

    Whatever ends this early leaves one of the two in use, whole.

    Raises:
        FrogError: if none was found, or a file cannot be read or written.
    """
    newest, name = _newest(folder)
    if newest is None:
        raise UsageError(f"{folder}: found no cameras_found.json that is not in use, expected one of frog calibrate.")
    path, content = folder / name, _content(newest)
    others = [folder / other for other in (_SOONER if name == _CAMERAS else _SOONER[:1]) if (folder / other).is_file()]
    before = [path, *others] if path.is_file() else others
    kept = [_kept(used, _GIVEN[used.name], _content(used)) for used in before]
    write_atomically(path, content)
    for other in others:
        other.unlink()
    return path, kept


def _named(folder: Path, stem: str, name: str) -> list[Path]:
    """``stem``, or that with a number, with the ending of ``name``."""
    paths = folder.glob(f"{stem}*{Path(name).suffix}")
    return [path for path in paths if path.stem == stem or path.stem.removeprefix(f"{stem}_").isdigit()]


def _newest(folder: Path) -> tuple[Path | None, str]:
    """The newest found file that is not in use, and the name that it would have in use; None where there is none."""
    paths = [(path, name) for name, stem in _FOUND.items() for path in _named(folder, stem, name)]
    unused = [(path, name) for path, name in paths if path.is_file() and not _is_same(path, folder / name)]
    newest_last = sorted(unused, key=lambda entry: (entry[0].stat().st_mtime_ns, len(entry[0].name), entry[0].name))
    return newest_last[-1] if newest_last else (None, "")


def _is_same(path: Path, other: Path) -> bool:
    return other.is_file() and os.path.getsize(path) == os.path.getsize(other) and _content(path) == _content(other)


def _content(path: Path) -> bytes:
    with in_words(f"{path}: could not be read", ", expected a calibration."):
        return path.read_bytes()


def _plain(folder: Path, calibration: Calibration, films: Sequence[Film]) -> JsonObject:
    cameras = []
    for calibrated, film in zip(calibration.cameras, films, strict=True):
        camera = calibrated.camera
        entry: JsonObject = {
            "name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "K": camera.intrinsics.tolist(),
            "dist": [*calibrated.distortion, 0.0, 0.0] if any(calibrated.distortion) else [],
            "R": camera.rotation.tolist(),
            "t": camera.world_to_camera[:3, 3].tolist(),
        }
        is_below = film.path.parent.resolve() == folder.resolve() and film.path.suffix.lower() not in IMAGE_SUFFIXES
        if not is_below and not film.path.is_dir():  # folders lie beside it, or images of several cameras in one
            entry["video"] = _path_from(folder, film.path)
        if (film.offset, film.rate) != (0.0, 1.0):
            entry |= {"offset": film.offset, "rate": film.rate}
        cameras.append(entry)
    return {"made_by": "frog calibrate", "cameras": cameras, "points": calibration.points.tolist()}


def _path_from(folder: Path, video: Path) -> str:
    """Relative to the calibration's folder where both lie on one disk, so that they can move together."""
    try:
        return Path(os.path.relpath(video.resolve(), folder.resolve())).as_posix()
    except ValueError:  # two drives of Windows
        return str(video.resolve())
