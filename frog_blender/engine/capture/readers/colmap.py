"""A COLMAP model (see ``colmap_model``) and the images it was made of, or what the same cameras filmed.

- ``images/cam00/0000.png``: the folder is the camera, the number the time. Where a folder's poses agree the camera
  stands, and all images of the folder are its, those without a pose too; else every image has its own pose.
- ``images/cam00_0000.png``: the same, the name up to its last number being the camera.
- ``images/cam00.png`` with ``cam00.mp4`` or a folder ``cam00`` beside: each image is a standing camera's, whose video
  or frames have its name or its number.
- ``images/cam00.png`` alone: standing cameras at one time, if their names begin with cam, camera, c or view.
- ``images/frame_00001.png``: one moving camera, in the order of the numbers.

Nothing is held out, but of one moving camera every eighth frame.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path, PurePosixPath

import numpy as np

from ...errors import FrogError, found_instead
from ..capture import Capture
from .assembly import matched, moving_cameras, standing_cameras, with_points
from .colmap_model import Model, PosedImage, has_model, read_model
from .footage import Footage, find_footage, images_in, of_cameras
from .readings import natural, split_number

_LAYOUT = "colmap"
_MODELS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse", "dense/0/sparse", "colmap", ".")
_IMAGES = ("images", "input", "dense/images", "colmap/images", "dense/0/images", "imgs", ".")
_BESIDE = (".", "videos", "images", "frames")
_ONE_TIME = re.compile(r"(.*[^a-z])?(cam|camera|c|view|gopro|cam_?view)[\W_]*\d*", re.IGNORECASE)
_SAME_TURN, _SAME_PLACE = np.radians(0.5), 0.005  # of the distance between the outermost cameras

Numbered = list[tuple[PosedImage, int]]
"""Images, and the numbers that are their times."""


def matches(path: Path) -> bool:
    """True if the folder holds a model where COLMAP and its users put it."""
    return bool(_model_folders(path))


def _model_folders(path: Path) -> list[Path]:
    return [path / name for name in _MODELS if has_model(path / name)]


def read(path: Path) -> Capture:
    """Open a folder with a COLMAP model.

    Raises:
        FrogError: if no image of the model is there, or a value cannot be used.
    """
    folder = _model_folders(path)[0]
    warnings: list[str] = []
    apart = [other for other in folder.parent.iterdir() if has_model(other)] if folder.name == "0" else []
    if len(apart) > 1:  # COLMAP numbers them as it began them
        folder = max(apart, key=_size)
        warnings.append(f"{folder}: the largest of {len(apart)} models is taken, which COLMAP found to be apart.")
    model = read_model(folder)
    model.images.sort(key=lambda image: natural(image.name))
    root = _image_root(path, model)
    groups = _by_camera(model)
    if not groups and (beside := _beside(path, model)):
        views = [model.camera(image, PurePosixPath(image.name).stem) for image in model.images]
        cameras, footage, about = matched(folder, views, beside, named_by_film=True)
        return with_points(standing_cameras(path, _LAYOUT, cameras, footage, [*warnings, *about]), model.points)
    count, first = len(model.images), model.images[0].name
    files = {image.name: file for image in model.images if (file := root / image.name).is_file()}
    if not files:
        raise found_instead(
            path,
            f"a COLMAP model of {count} images ({first}{', ...' if count > 1 else ''}) and none of these images",
            "them in images, or videos or folders of frames of their names",
        )
    if len(files) < count:
        warnings.append(f"{path}: {count - len(files)} of {count} images of the model are missing and left out.")
    capture = _standing(path, model, files, groups or _at_one_time(model), warnings)
    if capture is None:
        numbered = [image for of_camera in groups.values() for image in of_camera] or _in_order(model)
        posed = [
            (model.camera(image, str(PurePosixPath(image.name).with_suffix(""))), files[image.name], number)
            for image, number in numbered
            if image.name in files
        ]
        capture = moving_cameras(path, _LAYOUT, posed, warnings)
    return with_points(capture, model.points)


def _size(model: Path) -> int:
    """Bytes in which a model says its images."""
    return sum(file.stat().st_size for file in model.glob("images.*"))


def _image_root(path: Path, model: Model) -> Path:
    """The folder that the names of the model's images are relative to: in which most of them are."""
    for image in model.images:
        parts = PurePosixPath(image.name).parts
        if image.name.startswith("/") or ".." in parts or re.match("[A-Za-z]:", image.name):
            raise FrogError(f"{model.folder}: the image {image.name!r} lies outside the capture's folder.")
    some = model.images[:: max(1, len(model.images) // 100)]
    roots = [path / name for name in _IMAGES]
    return max(roots, key=lambda root: sum((root / image.name).is_file() for image in some))


def _by_camera(model: Model) -> dict[str, Numbered]:
    """The images by the camera that their names tell; {} where they tell one camera, or one image of each."""
    folders: dict[str, Numbered] = {}
    prefixes: dict[str, Numbered] = {}
    for index, image in enumerate(model.images):
        name = PurePosixPath(image.name)
        prefix, number = split_number(name.stem)
        folder = "_".join(part for part in name.parent.parts if part != "images")
        for groups, camera in ((folders, folder), (prefixes, prefix.rstrip("_-. "))):
            groups.setdefault(camera, []).append((image, index if number is None else number))
    if len(folders) > 1:
        return folders
    if len(model.frames) == len(model.images):
        return _by_rig(model)
    times = Counter(number for images in prefixes.values() for _, number in images)
    shared = sum(count > 1 for count in times.values()) * 2 >= len(times)
    return prefixes if len(prefixes) > 1 and shared and len(times) > 1 else {}


def _by_rig(model: Model) -> dict[str, Numbered]:
    """The images by the camera of their rig, which ``frames`` tells the times of."""
    frames = list(dict.fromkeys(model.frames[image.name] for image in model.images))
    order = {frame: rank for rank, frame in enumerate(frames)}
    groups: dict[str, Numbered] = {}
    for image in model.images:
        groups.setdefault(f"camera{image.camera}", []).append((image, order[model.frames[image.name]]))
    return groups


def _at_one_time(model: Model) -> dict[str, Numbered]:
    """The images, each of a camera of its own; {} where their names are not those of cameras."""
    groups: dict[str, Numbered] = {PurePosixPath(image.name).stem: [(image, 0)] for image in model.images}
    return groups if all(map(_ONE_TIME.fullmatch, groups)) else {}


def _in_order(model: Model) -> Numbered:
    """The images of one moving camera, by the numbers in their names if these differ."""
    numbers = [split_number(PurePosixPath(image.name).stem)[1] for image in model.images]
    ordered = [number for number in numbers if number is not None]
    is_ordered = len(set(ordered)) == len(model.images)
    return list(zip(model.images, ordered if is_ordered else range(len(numbers)), strict=True))


def _standing(
    path: Path, model: Model, files: dict[str, Path], groups: dict[str, Numbered], warnings: list[str]
) -> Capture | None:
    """The capture of cameras that stand still, by the images of each; None if one moves, or there is none."""
    extent = _extent(model)
    has_folders = len({PurePosixPath(image.name).parent for image in model.images}) > 1
    cameras, footage = [], []
    for name, numbered in groups.items():
        image = _middle([image for image, _ in numbered], extent)
        if image is None:
            return None
        there = {files[posed.name]: number for posed, number in numbered if posed.name in files}
        if there:
            whole = images_in(next(iter(there)).parent) if has_folders else None
            cameras.append(model.camera(image, name))
            footage.append(whole or Footage(name, tuple(there), tuple(there.values())))
    return standing_cameras(path, _LAYOUT, cameras, footage, warnings) if groups else None


def _beside(path: Path, model: Model) -> list[Footage]:
    """Videos or folders of frames of which most images of the model are the names."""
    stems = [PurePosixPath(image.name).stem for image in model.images]
    for folder in _BESIDE:
        footage = [filmed for filmed in find_footage(path / folder) if filmed.name not in _IMAGES]
        try:
            if footage and 2 * len(of_cameras(path, stems, footage)[0]) > len(stems):
                return footage
        except FrogError:
            continue
    return []


def _middle(images: list[PosedImage], extent: float) -> PosedImage | None:
    """The image in the middle of a camera's images, if all have the same pose up to what COLMAP may be off."""
    centers = np.array([image.center for image in images])
    apart = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    middle = images[int(apart.argmin())]
    cosines = [(np.trace(image.rotation.T @ middle.rotation) - 1) / 2 for image in images]
    turned = np.arccos(np.clip(cosines, -1, 1)).max()
    return middle if turned <= _SAME_TURN and apart.max() <= _SAME_PLACE * extent else None


def _extent(model: Model) -> float:
    """The largest extent of the camera centres along an axis; of the points where all centres agree."""
    centers = np.array([image.center for image in model.images])
    extent = float(np.ptp(centers, axis=0).max())
    spread = float(np.ptp(np.percentile(model.points, [10, 90], axis=0), axis=0).max()) if len(model.points) else 0.0
    return max(extent, 0.1 * spread)
