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
from .assembly import calibrated_cameras, moving_cameras, standing_cameras, with_points
from .colmap_model import Model, PosedImage, has_model, read_model
from .footage import Footage, find_footage, images_in, natural, of_cameras, split_number
from .geometry import Calibrated

_LAYOUT = "colmap"
_MODELS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse", "dense/0/sparse", "colmap", ".")
_IMAGES = ("images", "input", "dense/images", "colmap/images", "dense/0/images", "imgs", ".")
_BESIDE = (".", "videos", "images", "frames")
_ONE_TIME = re.compile(r"(.*[^a-z])?(cam|camera|c|view|gopro|cam_?view)[\W_]*\d*", re.IGNORECASE)
_SAME_TURN, _SAME_PLACE = np.radians(0.5), 0.005  # of the distance between the outermost cameras

Group = dict[str, list[tuple[PosedImage, int]]]
"""Images and their numbers by the camera's name."""


def matches(path: Path) -> bool:
    """True if the folder holds a model where COLMAP and its users put it."""
    return model_folder(path) is not None


def model_folder(path: Path) -> Path | None:
    """The folder of the model; None where there is none."""
    return next((path / name for name in _MODELS if has_model(path / name)), None)


def read(path: Path) -> Capture:
    """Open a folder with a COLMAP model.

    Raises:
        FrogError: if no image of the model is there, or a value cannot be used.
    """
    folder = model_folder(path)
    if folder is None:
        raise found_instead(path, "no COLMAP model", "cameras.bin and images.bin in sparse/0")
    model = read_model(folder)
    warnings: list[str] = []
    others = [other.name for other in folder.parent.iterdir() if other != folder and has_model(other)]
    if folder.name == "0" and others:
        warnings.append(f"{folder}: model 0 is taken, of {len(others) + 1} that COLMAP found to be apart.")
    model.images.sort(key=lambda image: natural(image.name))
    root = _image_root(path, model)
    if groups := _by_camera(model):
        capture = _grouped(path, model, root, groups, warnings)
    elif beside := _beside(path, model):
        capture = _footage_beside(path, model, beside, warnings)
    else:
        capture = _alone(path, model, root, warnings)
    return with_points(capture, model.points)


def _image_root(path: Path, model: Model) -> Path:
    """The folder that the names of the model's images are relative to: in which most of them are."""
    for image in model.images:
        parts = PurePosixPath(image.name).parts
        if image.name.startswith("/") or ".." in parts or re.match("[A-Za-z]:", image.name):
            raise FrogError(f"{model.folder}: the image {image.name!r} lies outside the capture's folder.")
    some = model.images[:: max(1, len(model.images) // 100)]
    roots = [path / name for name in _IMAGES]
    return max(roots, key=lambda root: sum((root / image.name).is_file() for image in some))


def _by_camera(model: Model) -> Group:
    """The images by the camera that their names tell; {} where they tell one camera, or one image of each."""
    folders: Group = {}
    prefixes: Group = {}
    for index, image in enumerate(model.images):
        name = PurePosixPath(image.name)
        prefix, number = split_number(name.stem)
        folder = "_".join(part for part in name.parent.parts if part != "images")
        folders.setdefault(folder, []).append((image, index if number is None else number))
        prefixes.setdefault(prefix.rstrip("_-. "), []).append((image, index if number is None else number))
    if len(folders) > 1:
        return folders
    if len(model.frames) == len(model.images):
        return _by_rig(model)
    times = Counter(number for images in prefixes.values() for _, number in images)
    shared = sum(count > 1 for count in times.values()) * 2 >= len(times)
    return prefixes if len(prefixes) > 1 and shared and len(times) > 1 else {}


def _by_rig(model: Model) -> Group:
    """The images by the camera of their rig, which ``frames`` tells the times of."""
    order = {
        frame: rank for rank, frame in enumerate(dict.fromkeys(model.frames[image.name] for image in model.images))
    }
    groups: Group = {}
    for image in model.images:
        groups.setdefault(f"camera{image.camera}", []).append((image, order[model.frames[image.name]]))
    return groups


def _grouped(path: Path, model: Model, root: Path, groups: Group, warnings: list[str]) -> Capture:
    """Several images of each camera."""
    extent = _extent(model)
    middles = {name: _standing([image for image, _ in images], extent) for name, images in groups.items()}
    standing = {name: image for name, image in middles.items() if image is not None}
    if len(standing) < len(groups):
        images = [(image, number) for of_camera in groups.values() for image, number in of_camera]
        return _moving(path, model, root, images, warnings)
    cameras: list[Calibrated] = []
    footage: list[Footage] = []
    lacking = 0
    for name, image in standing.items():
        files = {root / posed.name: number for posed, number in groups[name] if (root / posed.name).is_file()}
        lacking += len(groups[name]) - len(files)
        if files:
            whole = images_in((root / image.name).parent) if "/" in image.name else None
            cameras.append(model.camera(image, name))
            footage.append(whole or Footage(name, tuple(files), tuple(files.values())))
    if not footage:
        raise _no_image(path, model)
    if lacking:
        warnings.append(f"{path}: {lacking} of {len(model.images)} images of the model are missing and left out.")
    return standing_cameras(path, _LAYOUT, cameras, footage, warnings=warnings)


def _footage_beside(path: Path, model: Model, beside: list[Footage], warnings: list[str]) -> Capture:
    """One image of each camera, whose videos or frames lie beside."""
    cameras = [model.camera(image, PurePosixPath(image.name).stem) for image in model.images]
    return calibrated_cameras(path, _LAYOUT, model.folder, cameras, beside, warnings, named_by_film=True)


def _alone(path: Path, model: Model, root: Path, warnings: list[str]) -> Capture:
    """A flat list of images: standing cameras at one time, or one moving camera."""
    stems = [PurePosixPath(image.name).stem for image in model.images]
    numbers = [split_number(stem)[1] for stem in stems]
    if all(_ONE_TIME.fullmatch(stem) for stem in stems):
        cameras = [model.camera(image, stem) for image, stem in zip(model.images, stems, strict=True)]
        files = [root / image.name for image in model.images]
        there = [index for index, file in enumerate(files) if file.is_file()]
        if not there:
            raise _no_image(path, model)
        footage = [Footage(stems[index], (files[index],), (0,)) for index in there]
        return standing_cameras(path, _LAYOUT, [cameras[index] for index in there], footage, warnings=warnings)
    ordered = len(set(numbers)) == len(numbers) and None not in numbers
    places = [number if ordered and number is not None else place for place, number in enumerate(numbers)]
    return _moving(path, model, root, list(zip(model.images, places, strict=True)), warnings)


def _moving(path: Path, model: Model, root: Path, images: list[tuple[PosedImage, int]], warnings: list[str]) -> Capture:
    """Images that each have their own pose."""
    there = [(image, number) for image, number in images if (root / image.name).is_file()]
    if not there:
        raise _no_image(path, model)
    if len(there) < len(images):
        warnings.append(f"{path}: {len(images) - len(there)} of {len(images)} images are missing and left out.")
    views = []
    for image, number in there:
        name = PurePosixPath(image.name)
        views.append((model.camera(image, str(name.with_suffix(""))), root / image.name, number))
    return moving_cameras(path, _LAYOUT, views, warnings=warnings)


def _beside(path: Path, model: Model) -> list[Footage]:
    """Videos or folders of frames of which most images of the model are the names."""
    stems = [PurePosixPath(image.name).stem for image in model.images]
    for folder in _BESIDE:
        footage = [filmed for filmed in find_footage(path / folder) if f"{filmed.name}" not in _IMAGES]
        try:
            found = of_cameras(path, stems, footage)[0] if footage else {}
        except FrogError:
            continue
        if 2 * len(found) > len(stems):
            return footage
    return []


def _standing(images: list[PosedImage], extent: float) -> PosedImage | None:
    """The image in the middle of a camera's images, if all have the same pose up to what COLMAP may be off."""
    centers = np.array([-image.rotation.T @ image.translation for image in images])
    apart = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    middle = images[int(apart.argmin())]
    cosines = [(np.trace(image.rotation.T @ middle.rotation) - 1) / 2 for image in images]
    turned = np.arccos(np.clip(cosines, -1, 1)).max()
    return middle if turned <= _SAME_TURN and apart.max() <= _SAME_PLACE * extent else None


def _extent(model: Model) -> float:
    """The largest extent of the camera centres along an axis; of the points where all centres agree."""
    centers = np.array([-image.rotation.T @ image.translation for image in model.images])
    extent = float(np.ptp(centers, axis=0).max())
    spread = float(np.ptp(np.percentile(model.points, [10, 90], axis=0), axis=0).max()) if len(model.points) else 0.0
    return max(extent, 0.1 * spread)


def _no_image(path: Path, model: Model) -> FrogError:
    count, first = len(model.images), model.images[0].name
    return found_instead(
        path,
        f"a COLMAP model of {count} images ({first}{', ...' if count > 1 else ''}) and none of these images",
        "them in images, or videos or folders of frames of their names",
    )
