"""A COLMAP model (see ``colmap_model``) and the images it was made of, or what the same cameras filmed.

- ``images/cam00/0000.png``, ``images/cam00_0000.png``, ``images/0000/cam00.png``, ...: names and poses tell cameras and
  times (see ``readings``). Where a camera's poses agree it stands, and all images named so are its, those without a
  pose too; else every image has its own pose.
- ``images/cam00.png`` with ``cam00.mp4``, a folder ``cam00`` or folders ``frame000000``, ... of images ``cam00.png``
  beside: each image is a standing camera's, whose films or frames have its name or its number.
- ``frame000000/sparse/0``, ``colmap_0/sparse/0``, ...: a folder a moment, of standing cameras.
- ``images/cam00.png`` alone: standing cameras at one time; ``images/frame_00001.png``: one moving camera.

Nothing is held out, but of one moving camera every eighth frame.
"""

import re
from glob import escape, glob
from pathlib import Path, PurePosixPath

import numpy as np

from ...errors import FrogError, found_instead
from ..capture import Capture
from ..natural_order import natural
from ..video import find_images
from .assembly import matched, moving_cameras, standing_cameras, with_points
from .colmap_model import Model, has_model, read_model
from .filmed import filmed_by, fits_shifted
from .footage import DIGITS, Footage, find_footage
from .readings import CAMERAS, FOLDERS, Reading, View, is_moment, middle, read_names

_LAYOUT = "colmap"
_MODELS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse", "dense/0/sparse", "colmap", ".")
_IMAGES = ("images", "input", "dense/images", "colmap/images", "dense/0/images", "imgs", ".")
_BESIDE = (".", "videos", "images", "frames")
_MOST_PATTERNS = 200


def matches(path: Path) -> bool:
    """True if the folder holds a model where COLMAP and its users put it, or folders of moments with one."""
    return bool(_model_folders(path) or _moments(path))


def _model_folders(path: Path) -> list[Path]:
    return [path / name for name in _MODELS if has_model(path / name)]


def _moments(path: Path) -> list[Path]:
    """The folders of a rig's moments, in order: named alike but for a number, the first with a model; [] for none."""
    there = (folder for folder in path.iterdir() if is_moment(folder.name) and folder.is_dir())
    folders = sorted(there, key=lambda folder: natural(folder.name))
    alike = [folder for folder in folders if DIGITS.sub("", folder.name) == DIGITS.sub("", folders[0].name)]
    if len(alike) < 2 or not _model_folders(alike[0]):
        return []
    is_named = not alike[0].name.isdecimal()  # else they may be captures of their own
    return alike if is_named or not _differ(alike) else []


def _differ(moments: list[Path]) -> bool:
    """Whether the models in the first and the last folder place an image of one name differently, or share none."""
    if not (last := _model_folders(moments[-1])):
        return False
    model = read_model(_model_folders(moments[0])[0])
    poses = {image.name: image.pose for image in read_model(last[0]).images}
    pairs = [(image.pose, poses[image.name]) for image in model.images if image.name in poses]
    extent = _extent(model)
    return not pairs or any(middle(pair, extent) is None for pair in pairs)


def read(path: Path) -> Capture:
    """Open a folder with a COLMAP model.

    Raises:
        FrogError: if no image of the model is there, its names can be read in two ways, or a value cannot be used.
    """
    moments = [] if _model_folders(path) else _moments(path)
    folder = _model_folders(moments[0] if moments else path)[0]
    warnings: list[str] = []
    apart = [other for other in folder.parent.iterdir() if has_model(other)] if folder.name == "0" else []
    if len(apart) > 1:  # COLMAP numbers them as it began them
        folder = max(apart, key=lambda model: sum(file.stat().st_size for file in model.glob("images.*")))
        warnings.append(f"{folder}: the largest of {len(apart)} models is taken, which COLMAP found to be apart.")
    if moments and _differ(moments):
        warnings.append(
            f"{path}: the models of {moments[0].name} and {moments[-1].name} differ; the cameras are taken to stand "
            "where the first says."
        )
    model = read_model(folder)
    model.images.sort(key=lambda image: natural(image.name))
    root = _image_root(path, model)
    unposed = _unposed(root, [image.name for image in model.images if "/" in image.name or not model.frames])
    names = [*(image.name for image in model.images), *unposed]
    reading = _reading(path, model, names)
    if not reading.is_grid and (beside := _beside(path, model, warnings)):
        views = [model.camera(image, PurePosixPath(image.name).stem) for image in model.images]
        cameras, footage, about = matched(folder, views, beside, named_by_film=True)
        return with_points(standing_cameras(path, _LAYOUT, cameras, footage, [*warnings, *about]), model.points)
    count, first = len(model.images), model.images[0].name
    files = {index: file for index, name in enumerate(names) if (file := root / name).is_file()}
    if not files:
        raise found_instead(
            path,
            f"a COLMAP model of {count} images ({first}{', ...' if count > 1 else ''}) and none of these images",
            "them in images, or videos or folders of frames of their names",
        )
    if missing := len(names) - len(files):
        warnings.append(f"{path}: {missing} of {count} images of the model are missing and left out.")
    warnings += [reading.doubt] if reading.doubt else []
    capture = _standing(path, model, reading, files, warnings)
    if capture is None:
        posed = [
            (model.camera(image, str(PurePosixPath(image.name).with_suffix(""))), files[index], reading.times[index])
            for index, image in enumerate(model.images)
            if index in files
        ]
        capture = moving_cameras(path, _LAYOUT, posed, warnings)
    return with_points(capture, model.points)


def _unposed(root: Path, names: list[str]) -> list[str]:
    """Images beside these, and named as these are."""
    known, shapes = {*names}, {DIGITS.sub("0", name) for name in names}
    patterns = {DIGITS.sub("*", escape(str(PurePosixPath(name).parent))) for name in names}
    patterns = patterns if len(patterns) <= _MOST_PATTERNS else set()  # each lists a folder
    folders = sorted(folder for pattern in patterns for folder in glob(pattern, root_dir=root))
    there = [file.relative_to(root).as_posix() for folder in folders for file in find_images(root / folder)]
    return [name for name in there if name not in known and DIGITS.sub("0", name) in shapes]


def _reading(path: Path, model: Model, names: list[str]) -> Reading:
    """Which cameras and times the images have."""
    if len({PurePosixPath(name).parent for name in names}) == 1 and len(model.frames) == len(names):
        order: dict[int, int] = {}  # of the moments of a rig, where no folder tells its cameras
        times = tuple(order.setdefault(model.frames[name], len(order)) for name in names)
        return Reading(CAMERAS, FOLDERS, tuple(f"camera{image.camera}" for image in model.images), times)
    views = [View(image.pose, image.camera) for image in model.images]
    return read_names(path, names, views + [View()] * (len(names) - len(views)), _extent(model))


def _image_root(path: Path, model: Model) -> Path:
    """The folder that the names of the model's images are relative to: in which most of them are."""
    for image in model.images:
        parts = PurePosixPath(image.name).parts
        if image.name.startswith("/") or ".." in parts or re.match("[A-Za-z]:", image.name):
            raise FrogError(f"{model.folder}: the image {image.name!r} lies outside the capture's folder.")
    some = model.images[:: max(1, len(model.images) // 100)]
    roots = [path / name for name in _IMAGES]
    return max(roots, key=lambda root: sum((root / image.name).is_file() for image in some))


def _standing(path: Path, model: Model, reading: Reading, files: dict[int, Path], said: list[str]) -> Capture | None:
    """The capture of cameras that stand still, with all images that are named as theirs; None if one moves.

    Args:
        files: the images that are there, by their places in the reading, the model's first.
        said: warnings, to which those about cameras without a pose are added.
    """
    of_cameras: dict[str, list[int]] = {}
    for index in sorted(files, key=lambda index: (natural(reading.cameras[index]), reading.times[index])):
        of_cameras.setdefault(reading.cameras[index], []).append(index)
    cameras, footage, extent = [], [], _extent(model)
    for name, indices in of_cameras.items():
        posed = [model.images[index] for index in indices if index < len(model.images)]
        nearest = middle([image.pose for image in posed], extent) if posed else 0
        if nearest is None:
            return None
        if posed:
            cameras.append(model.camera(posed[nearest], name))
            times = tuple(reading.times[index] for index in indices)
            footage.append(Footage(name, tuple(files[index] for index in indices), times))
        else:
            said.append(f"{path}: the camera {name} has {len(indices)} images and no pose, and is left out.")
    return standing_cameras(path, _LAYOUT, cameras, footage, said)


def _beside(path: Path, model: Model, warnings: list[str]) -> list[Footage]:
    """Videos or folders of frames of which most images of the model are the names; a warning is added about others."""
    stems = [PurePosixPath(image.name).stem for image in model.images]
    aside: set[str] = set()
    for folder in _BESIDE:
        footage = [filmed for filmed in find_footage(path / folder) if filmed.name not in _IMAGES]
        filmed = max(map(len, filmed_by(path, stems, footage)[0].values()), default=0)
        if filmed and 2 * max(filmed, fits_shifted(stems, footage)) > len(stems):
            return footage
        aside |= {str(film.files[0].relative_to(path)) for film in footage if film.is_video}
    if len(aside) > 1:  # a single one may be that which a moving camera's images were taken from
        warnings.append(
            f"{path}: {len(aside)} videos ({min(aside)} ...) are not used: images of the model are not theirs."
        )
    return []


def _extent(model: Model) -> float:
    """The largest extent of the camera centres along an axis; of the points where all centres agree."""
    centers = np.array([image.center for image in model.images])
    extent = float(np.ptp(centers, axis=0).max())
    spread = float(np.ptp(np.percentile(model.points, [10, 90], axis=0), axis=0).max()) if len(model.points) else 0.0
    return max(extent, 0.1 * spread)
