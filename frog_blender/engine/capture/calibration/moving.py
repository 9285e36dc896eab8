"""One moving camera: a film, or images in order, to a list of posed images that every reader of captures knows."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, brief
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ..image_size import image_size
from ..video import decode, find_images, find_videos, load_opencv
from .child_process import REQUEST, CalibrationCancelled, Progress, run
from .films import Film
from .result_files import free_path, is_calibrated
from .work_folder import WorkFolder

_LEAST_IMAGES = 8
_MOST_IMAGES = 300
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
            if len(images) >= _LEAST_IMAGES:
                return images
    return []


def calibrate_moving(
    images: Sequence[Path],
    film: Film | None,
    out: Path,
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
) -> tuple[Path, JsonObject, list[str]]:
    """Finds where a moving camera was at each image, and writes the list of posed images.

    Args:
        images: of the camera, in order; or none where ``film`` is given.
        out: folder of the result. It gets the images as well where they lie elsewhere or in a film.

    Returns:
        The list, the child's result, and warnings.

    Raises:
        CalibrationRefused: if the images do not fix the poses.
        CalibrationCancelled: if ``cancelled`` said so.
        FrogError: if the images cannot be used or the result cannot be written.
    """
    listed, rate, warnings = _listed(images, film, out, progress, cancelled)
    sizes = {image_size(path) for path in listed}
    if len(sizes) > 1:
        raise FrogError(f"{listed[0].parent}: found images of {len(sizes)} sizes, expected those of one camera.")
    (size,) = sizes
    folder = work.path / "moving"
    request = {"work": str(work.path), "images": [str(path) for path in listed], "size": list(size)}
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    result = run("moving", folder, progress, cancelled)
    try:
        content = json.dumps(_transforms(out, listed, result, rate), indent=1).encode()
        warnings += [str(each) for each in result["warnings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise FrogError(f"{folder}: found a result that is damaged ({brief(error)}), expected a whole one.") from error
    path = free_path(out, _LIST, _FOUND, content, given=is_calibrated(out))
    if not path.exists():
        write_atomically(path, content)
    return path, result, warnings


def _listed(
    images: Sequence[Path], film: Film | None, out: Path, progress: Progress, cancelled: Callable[[], bool]
) -> tuple[list[Path], float, list[str]]:
    """The images inside ``out``, their rate, and warnings."""
    if film is None:
        inside = all(path.resolve().is_relative_to(out.resolve()) for path in images)
        return (list(images) if inside else _copied(images, out / "images")), _FRAMES_PER_SECOND, []
    count = film.facts.frame_count
    if count < _LEAST_IMAGES:
        raise FrogError(f"{film.path}: found {count} frames, expected at least {_LEAST_IMAGES} of a moving camera.")
    step = -(-count // _MOST_IMAGES)
    frames = list(range(0, count, step))
    warnings = [f"{film.path.name}: every {step}. frame is used."] if step > 1 else []
    target = out / f"{film.name}_images"
    paths = [target / f"{frame:06d}.png" for frame in frames]
    for place, path in enumerate(_written(film, frames, paths)):
        progress("images", place, len(paths))
        if cancelled():
            raise CalibrationCancelled
        del path
    return paths, film.facts.frames_per_second / step, warnings


def _written(film: Film, frames: Sequence[int], paths: Sequence[Path]) -> Iterator[Path]:
    """Writes the frames that are not there yet, without loss."""
    cv2 = load_opencv()
    missing = [frame for frame, path in zip(frames, paths, strict=True) if not path.is_file()]
    by_frame = dict(zip(frames, paths, strict=True))
    for frame, image in zip(missing, decode(film.path, missing), strict=True):
        _, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        write_atomically(by_frame[frame], content.tobytes())
        yield by_frame[frame]


def _copied(images: Sequence[Path], target: Path) -> list[Path]:
    """The images copied into a folder, those that are there already left as they are."""
    target.mkdir(parents=True, exist_ok=True)
    for image in images:
        if not (target / image.name).is_file():
            shutil.copyfile(image, target / image.name)
    return [target / image.name for image in images]


def _transforms(out: Path, images: Sequence[Path], result: JsonObject, rate: float) -> JsonObject:
    """nerfstudio's list: camera to world in OpenGL's axes, and a time for each image."""
    lens = result["lens"]
    width, height, focal = int(lens["width"]), int(lens["height"]), float(lens["focal"])
    frames = []
    for place, pose in zip(result["placed"], result["poses"], strict=True):
        matrix: Float64s = np.vstack([np.asarray(pose, np.float64).reshape(3, 4), [[0.0, 0.0, 0.0, 1.0]]])
        frames.append(
            {
                "file_path": images[place].resolve().relative_to(out.resolve()).as_posix(),
                "transform_matrix": (np.linalg.inv(matrix) @ _FLIP).tolist(),
                "time": place / max(len(images) - 1, 1),
            }
        )
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
        "fps": rate,
        "frames": frames,
    }
