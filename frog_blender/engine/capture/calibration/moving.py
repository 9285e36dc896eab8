"""Moving cameras: films, or one's images in order, to a list of posed images that every reader of captures knows."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, brief
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, Progress
from ...io.plain_values import JsonObject
from ..readers.frame_times import frame_times
from ..video import find_images, find_videos, image_size
from .camera_kinds import numbered
from .child_process import run
from .films import Film
from .moving_films import LEAST_IMAGES, sampled, written
from .result_files import free_path, is_calibrated
from .walk import Walk
from .work_folder import WorkFolder

_LIST, _FOUND = "transforms.json", "transforms_found"
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV's axes to OpenGL's
_FOLDERS = (".", "images", "input", "frames")
_FRAMES_PER_SECOND = 30.0


def still_images(folder: Path) -> list[Path]:
    """The images of a moving camera in order of their names, where a folder holds such and no video; else none."""
    if find_videos(folder):
        return []
    for name in _FOLDERS:
        if (folder / name).is_dir():
            images = find_images(folder / name)
            if len(images) >= LEAST_IMAGES:
                return images
    return []


def calibrate_moving(
    footage: Sequence[Path] | Sequence[Film],
    out: Path,
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
) -> tuple[Path, JsonObject, list[str]]:
    """Finds where moving cameras were at each image, and writes the list of posed images.

    Args:
        footage: images of one camera, in order, or the films of one or several, with their clocks.
        out: folder of the result. It gets the images as well where they lie elsewhere or in a film.

    Returns:
        The list, the child's result, and warnings.

    Raises:
        CalibrationRefused: if the images do not fix the poses.
        Stopped: if ``cancelled`` said so.
        FrogError: if the images cannot be used or the result cannot be written.
    """
    films = [each for each in footage if isinstance(each, Film)]
    if films:
        walks, times, warnings = _of_films(films, out, progress, cancelled)
    else:
        walks, times, warnings = _of_images([each for each in footage if isinstance(each, Path)], out)
    folder = work.path / "moving"
    request = {"work": str(work.path), "walks": [walk.plain() for walk in walks]}
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    result = run("moving", folder, progress, cancelled)
    rate = _rate(times, out / _LIST) if films else _FRAMES_PER_SECOND
    try:
        content = json.dumps(_transforms(out, walks, times, result) | {"fps": rate}, indent=1).encode()
        warnings += [str(each) for each in result["warnings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise FrogError(f"{folder}: found a result that is damaged ({brief(error)}), expected a whole one.") from error
    path = free_path(out, _LIST, _FOUND, content, given=is_calibrated(out))
    if not path.exists():
        write_atomically(path, content)
    return path, result, warnings


def _of_films(
    films: Sequence[Film], out: Path, progress: Progress, cancelled: Callable[[], bool]
) -> tuple[list[Walk], list[float], list[str]]:
    """The films' images below ``out``, when each was taken in seconds, and warnings."""
    frames, step = sampled(films)
    warnings = []
    if step > 1:
        warnings.append(f"{', '.join(film.path.name for film in films)}: every {step}. frame is used.")
    groups = numbered([(film.size, film.kind) for film in films])
    walks, times = [], []
    for film, own, group in zip(films, frames, groups, strict=True):
        paths = written(film, own, out / f"{film.name}_images", progress, cancelled)
        walks.append(Walk(film.name, tuple(paths), film.size, group))
        times += [film.time_of(frame) for frame in own]
    first = min(times)
    return walks, [round(time - first, 6) for time in times], warnings  # to what readers tell apart


def _of_images(images: Sequence[Path], out: Path) -> tuple[list[Walk], list[float], list[str]]:
    """The images inside ``out``, when each was taken from 0 to 1, and no warnings."""
    sizes = {image_size(path) for path in images}
    if len(sizes) > 1:
        raise FrogError(f"{images[0].parent}: found images of {len(sizes)} sizes, expected those of one camera.")
    inside = all(path.resolve().is_relative_to(out.resolve()) for path in images)
    listed = list(images) if inside else _copied(images, out / "images")
    times = (np.arange(len(listed)) / max(len(listed) - 1, 1)).tolist()
    return [Walk("camera", tuple(listed), sizes.pop())], times, []


def _copied(images: Sequence[Path], target: Path) -> list[Path]:
    """The images copied into a folder, those that are there already left as they are."""
    target.mkdir(parents=True, exist_ok=True)
    for image in images:
        if not (target / image.name).is_file():
            shutil.copyfile(image, target / image.name)
    return [target / image.name for image in images]


def _rate(times: Sequence[float], path: Path) -> float:
    """Frames a second as readers will count them: those of several cameras may lie between each other."""
    frames = frame_times(times, [0] * len(times), path).frames
    span = max(times) - min(times)
    return float((frames.max() - frames.min()) / span) if span > 0 else _FRAMES_PER_SECOND


def _transforms(out: Path, walks: Sequence[Walk], times: Sequence[float], result: JsonObject) -> JsonObject:
    """nerfstudio's list: camera to world in OpenGL's axes, and a time for each image.

    The lens of one camera is everyone's; of several each image has its own.
    """
    lenses = [_lens(lens) for lens in result["lenses"]]
    images = [(path, number) for number, walk in enumerate(walks) for path in walk.images]
    frames = []
    for place, pose in zip(result["placed"], result["poses"], strict=True):
        matrix: Float64s = np.vstack([np.asarray(pose, np.float64).reshape(3, 4), [[0.0, 0.0, 0.0, 1.0]]])
        path, number = images[place]
        frame = {
            "file_path": path.resolve().relative_to(out.resolve()).as_posix(),
            "transform_matrix": (np.linalg.inv(matrix) @ _FLIP).tolist(),
            "time": times[place],
        }
        frames.append(frame if len(walks) == 1 else frame | lenses[number])
    return (lenses[0] if len(walks) == 1 else {}) | {"frames": frames}


def _lens(lens: JsonObject) -> JsonObject:
    width, height, focal = int(lens["width"]), int(lens["height"]), float(lens["focal"])
    return {
        "camera_model": "OPENCV",
        "w": width,
        "h": height,
        "fl_x": focal,
        "fl_y": focal,
        "cx": width / 2,
        "cy": height / 2,
        "k1": float(lens["k1"]),
        "k2": float(lens["k2"]),
        "p1": 0.0,
        "p2": 0.0,
    }
