"""Images with ``transforms.json`` (nerfstudio) or ``transforms_train.json`` (D-NeRF, Blender).

Each listed image has its own pose: camera-to-world in OpenGL's axes (x right, y up, looking along -z). Intrinsics
and distortion stand at the top level or with an image, whose own values win. Images of one static camera are found by
their equal poses. ``time`` is optional: without it the numbers in the images' names are times, of each static camera
apart; COLMAP, and so converters, list images in no order. What is missing among times or numbers stays a gap.
"""

import json
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import found_instead
from ..camera import Camera
from ..capture import Capture, Shot
from ..lenses import FISHEYE
from ..masking import MaskSource
from ..video import image_size, with_ending
from .assembly import assembled, with_holdout_of_one
from .checks import flag, number, path_inside, read_json, records, rigid, size
from .footage import RATE, Footage
from .frame_times import camera_names, first_images, frame_times, times_by_name
from .geometry import OPENGL_AXES, Calibrated, distortion, intrinsics, pose, through_lens
from .pairing import Pairing, gaps

_SINGLE = "transforms.json"
_TRAIN = "transforms_train.json"
_HELD_OUT = ("transforms_val.json", "transforms_test.json")
_LISTED = '"frames": [{"file_path": ..., "transform_matrix": ...}, ...]'
_MAX_RATE = 1e6  # images a second
_MAX_TIME = 1e30  # in any unit, such as nanoseconds since 1970
_LENS = ("camera_model", "is_fisheye", "w", "h", "fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "cx", "cy")
_UNUSED = ("s1", "s2", "s3", "s4", "sx1", "sy1", "b1", "b2", "skew", "omega")  # prisms, skewed pixels, other models
_FISHEYES = frozenset({"OPENCV_FISHEYE", "FISHEYE", "RADIAL_FISHEYE", "SIMPLE_RADIAL_FISHEYE"})
_DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # OpenCV's order
_VIEW = ("transform_matrix", *_LENS, *_DISTORTION)  # what tells an image's camera from another's
_MODELS = frozenset(
    {"PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"}
)  # whose distortion is OpenCV's


@dataclass(frozen=True)
class _Entry:
    """A listed image that exists.

    Attributes:
        file: the list.
        top, own: what it says of all its images, and of this one.
        image: the file.
        time: its own, or by its name (see ``times_by_name``), missing images counted.
        view: its pose and lens: equal to another image's where both are known to be the same.
    """

    file: Path
    top: dict[str, object]
    own: dict[str, object]
    image: Path
    time: float
    view: str


def matches(path: Path) -> bool:
    """True if the folder holds ``transforms.json`` or ``transforms_train.json``."""
    return (path / _SINGLE).is_file() or (path / _TRAIN).is_file()


def read(path: Path) -> Capture:
    """Open a folder of posed images.

    Every eighth frame of a single moving camera is held out; with separate lists, the test and val images are.

    Raises:
        FrogError: if no listed image exists, a path leads outside the folder, or a value cannot be used.
    """
    entries, names, warnings = _entries(path)
    training = entries[0].file
    has_splits = training.name != _SINGLE
    several = Counter(names)  # images of a camera that stands: only these must not be at one frame
    lists = [name if several[name] > 1 else entry.file.name for name, entry in zip(names, entries, strict=True)]
    times = frame_times([entry.time for entry in entries], lists, training)
    warnings += times.warnings
    first = dict(zip(reversed(names), reversed(entries), strict=True))  # image of each camera
    index = {name: index for index, name in enumerate(dict.fromkeys(names))}
    placed = zip(names, times.frames.tolist(), entries, times.offsets.tolist(), strict=True)
    shots = [
        Shot(index[name], frame, entry.image, 0, offset, ignore=_ignored(path, entry))
        for name, frame, entry, offset in placed
    ]
    warnings += _unusual(entries, shots)
    of_training = [shot for shot, entry in zip(shots, entries, strict=True) if entry.file == training]
    images = Counter(shot.camera for shot in of_training)
    if 2 * sum(count > 1 for count in images.values()) > len(images):  # most stand
        warnings += gaps(training, of_training, len(images), times.count)
    rate = number(entries[0].top.get("fps", RATE), training, "fps", positive=True, most=_MAX_RATE)
    capture = assembled(
        path,
        "transforms",
        [_camera(name, first[name]) for name in index],
        [Footage.of_image(first[name].image) for name in index],
        Pairing(shots, times.count, rate, warnings),
        test_cameras=frozenset(name for name, entry in first.items() if entry.file != training),
        # D-NeRF's images are composited over white, as in all published results.
        background=(1.0, 1.0, 1.0) if has_splits else (0.0, 0.0, 0.0),
    )
    return capture if has_splits else with_holdout_of_one(capture)


def images_by_camera(path: Path) -> dict[str, list[Path]]:
    """The images of each camera by its name, in order of time, of those that exist; nothing is decoded.

    Raises:
        FrogError: for a list that cannot be used.
    """
    entries, names, _ = _entries(path)
    images: dict[str, list[Path]] = {}
    for entry, name in sorted(zip(entries, names, strict=True), key=lambda named: named[0].time):
        images.setdefault(name, []).append(entry.image)
    return images


def posed_cameras(file: Path) -> Iterator[tuple[Calibrated, Path, dict[str, object]]]:
    """The camera of each image of a list, named after it, with its lens; where the image would lie, and what the list
    says of it alone.

    Raises:
        FrogError: for a list that cannot be used, and for an image that is not there and whose size is not said.
    """
    top = read_json(file)
    for index, own in enumerate(records(top.get("frames"), file, "frames", _LISTED)):
        image = path_inside(file.parent, own.get("file_path", str(index)), file, "file_path")
        yield _camera(image.stem, _Entry(file, top, own, image, 0.0, "")), image, own


def posed_images(file: Path) -> list[tuple[Camera, Path, dict[str, object]]]:
    """The camera of each image of a list, named after it, the image, and what the list says of it alone.

    Raises:
        FrogError: for a list that cannot be used, an image that is not there, or a lens with distortion.
    """
    views = []
    for (camera, lens), image, own in posed_cameras(file):
        if lens is not None:
            raise found_instead(file, f"lens distortion of {image.name}", "images without any")
        if image_size(image) != (camera.width, camera.height):
            found = "{} x {} pixels".format(*image_size(image))
            raise found_instead(image, found, f"{camera.width} x {camera.height} as {file.name} says")
        views.append((camera, image, own))
    return views


def _entries(folder: Path) -> tuple[list[_Entry], list[str], list[str]]:
    """The images of all lists that exist, training images first, the name of each one's camera, and warnings; FrogError
    if no training image exists. Training and held-out lists have no camera in common."""
    files = [folder / _SINGLE]
    if not files[0].is_file():
        files = [folder / _TRAIN, *(folder / name for name in _HELD_OUT if (folder / name).is_file())]
    entries: list[_Entry] = []
    first: list[int] = []  # of each image its camera's first one
    warnings: list[str] = []
    timed: set[bool] = set()
    for file in files:
        top = read_json(file)
        frames = records(top.get("frames"), file, "frames", _LISTED)
        paths = [path_inside(folder, frame.get("file_path"), file, "file_path") for frame in frames]
        names = [str(frame["file_path"]).replace("\\", "/") for frame in frames]
        views = [_view(frame, index) for index, frame in enumerate(frames)]
        stated = sum(frame.get("time") is not None for frame in frames)
        timed.add(stated == len(frames))
        if len(timed) > 1:
            raise found_instead(folder, "lists with times for all images and others without", "times in all or none")
        if timed == {True}:
            # Rounded, so that 1/3 written with 6 digits by one list and 16 by another is one time.
            times = [round(number(frame["time"], file, "time", most=_MAX_TIME), 6) for frame in frames]
        else:
            times, doubt = times_by_name(file, names, views)
            told = f'{file}: {stated} of {len(frames)} images say their "time"; it is used where all do.'
            warnings += filter(None, [doubt, told if stated else ""])
        images = [path if os.path.isfile(path) else with_ending(path) for path in paths]
        listed = zip(frames, images, times, views, strict=True)
        there = [_Entry(file, top, frame, image, time, view) for frame, image, time, view in listed if image]
        if not entries and not there:
            raise found_instead(file, f"{len(frames)} listed images of which none exists", "the images beside it")
        if lacking := len(frames) - len(there):
            warnings.append(f"{file}: {lacking} of {len(frames)} listed images are missing and left out.")
        views, times = [entry.view for entry in there], [entry.time for entry in there]
        first += [len(entries) + index for index in first_images(views, times)]
        entries += there
    return entries, camera_names(first, _image_names(folder, [entry.image for entry in entries])), warnings


def _ignored(folder: Path, entry: _Entry) -> MaskSource | None:
    """What an image's ``mask_path`` says is not to be learned: in nerfstudio, what is black. None without one."""
    if (name := entry.own.get("mask_path")) is None:
        return None
    mask = path_inside(folder, name, entry.file, "mask_path")
    return MaskSource(mask, inverted=True) if os.path.isfile(mask) else None


def _view(own: dict[str, object], index: int) -> str:
    """Pose and lens of image ``index``: equal to another image's where both are known to be the same."""
    return json.dumps([own.get(key) for key in _VIEW] if own.get("transform_matrix") is not None else index)


def _unusual(entries: list[_Entry], shots: list[Shot]) -> Iterator[str]:
    """What of the lists is not used, could mean something else, or is missing."""
    file = entries[0].file
    models = {_model(entry) for entry in entries if any(_both(entry).get(key) for key in _DISTORTION[5:])}
    if models - {"FULL_OPENCV", *_FISHEYES}:
        yield f"{file}: k4, k5 and k6 are taken for those of OpenCV's rational model."
    if unused := sorted({key for entry in entries for key in _unused_terms(entry)}):
        yield f"{file}: the lens has {', '.join(unused)}, which are not used."
    listed = sum(entry.own.get("mask_path") is not None for entry in entries)
    if missing := listed - sum(shot.ignore is not None for shot in shots):
        yield f"{file}: {missing} of {listed} masks (mask_path) are missing; those images count whole."


def _unused_terms(entry: _Entry) -> list[str]:
    """What an entry says of its lens, and no camera here can do."""
    tangential = ("p1", "p2") if _is_fisheye(entry) else ()
    return [key for key in (*_UNUSED, *tangential) if _both(entry).get(key) not in (None, 0, 0.0)]


def _is_fisheye(entry: _Entry) -> bool:
    return _model(entry) in _FISHEYES or flag(_both(entry).get("is_fisheye"), entry.file, "is_fisheye")


def _both(entry: _Entry) -> dict[str, object]:
    return {**entry.top, **entry.own}


def _model(entry: _Entry) -> str:
    return str(_both(entry).get("camera_model", "OPENCV")).upper()


def _image_names(folder: Path, images: list[Path]) -> list[str]:
    """A unique name for each image: the file's name, with its folders where that is not unique."""
    stems = [image.stem for image in images]
    if len(set(stems)) == len(stems):
        return stems
    names = [Path(os.path.relpath(image, folder)).as_posix() for image in images]
    return names if len(set(names)) == len(names) else [f"{name}#{index}" for index, name in enumerate(names)]


def _camera(name: str, entry: _Entry) -> Calibrated:
    """The OpenCV camera of one image, and its lens, at the size that the list says."""
    file, both, model = entry.file, _both(entry), _model(entry)
    is_fisheye = _is_fisheye(entry)
    if not is_fisheye and model not in _MODELS:
        expected = f"a perspective camera ({', '.join(sorted(_MODELS))}) or OPENCV_FISHEYE"
        raise found_instead(file, f"the camera model {model}", expected)
    real = image_size(entry.image) if not {"w", "h"} <= both.keys() else (0, 0)
    width, height = (size(both.get(key, side), file, key) for key, side in zip("wh", real, strict=True))
    focal_x = _focal(entry, "x", width)
    if focal_x is None:
        raise found_instead(file, "no focal length", "fl_x or camera_angle_x")
    focal_y = _focal(entry, "y", height)
    center_x = number(both.get("cx", width / 2), file, "cx")
    center_y = number(both.get("cy", height / 2), file, "cy")
    lens = intrinsics(focal_x, focal_y or focal_x, center_x, center_y)
    matrix = rigid(entry.own.get("transform_matrix"), file, f"transform_matrix of {name}")
    camera = Camera(name, width, height, lens, pose(OPENGL_AXES @ matrix[:3, :3].T, matrix[:3, 3]))
    coefficients = np.array([number(both.get(key, 0.0), file, key) for key in _DISTORTION])
    if is_fisheye:
        return through_lens(camera, FISHEYE, coefficients[[0, 1, 4, 5]], file)
    return camera, distortion(coefficients if coefficients[5:].any() else coefficients[:5])


def _focal(entry: _Entry, axis: str, pixels: int) -> float | None:
    """Focal length in pixels along x or y: the image's own before the list's, fl before the angle."""
    for source in (entry.own, entry.top):
        if source.get(f"fl_{axis}") is not None:
            return number(source[f"fl_{axis}"], entry.file, f"fl_{axis}", positive=True)
        is_own = source is entry.own
        if axis == "y" and is_own and any(source.get(key) is not None for key in ("fl_x", "camera_angle_x")):
            return None  # square pixels: do not mix an image's own fl_x with the list's fl_y
        if source.get(f"camera_angle_{axis}") is not None:
            angle = number(source[f"camera_angle_{axis}"], entry.file, f"camera_angle_{axis}", positive=True)
            if angle >= np.pi:
                raise found_instead(entry.file, f"camera_angle_{axis} = {angle:g}", "less than pi (radians)")
            return float(pixels / (2 * np.tan(angle / 2)))
    return None
