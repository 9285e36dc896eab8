"""Videos and a calibration: ``cameras_opencv.json`` or Qualisys' ``*.qca.txt``.

A video, or a folder of frames, belongs to the calibrated camera of its name (``cam01.mp4`` to ``cam01``, see
``footage``), a video also to the one whose ``video`` is its path, from the calibration's folder. A camera's ``offset``
and ``rate`` say when it filmed (see ``pairing.Clock``); without them, films of constant rate are in step. ``points``
are seed points. Nothing is held out.

Qualisys' file is XML with lengths in mm and pixels times 64; it may lie in a project (see ``projects``).
"""

from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead, listed
from ...io.paths import is_network_path
from ...io.regular_file import check_length
from ..camera import Camera
from ..capture import Capture, Distortion
from ..video import composed
from .assembly import standing_cameras, with_points
from .checks import check_names, number, numbers, read_json, records, rotation, size
from .filmed import of_cameras
from .footage import Footage, footage_of
from .geometry import OPENGL_AXES, Calibrated, as_shown, distortion, is_transposed, opencv_camera, pose
from .pairing import Clock
from .projects import calibrations, recorded, the_calibration

_LAYOUT = "calibrated_videos"
_OPENCV, _QUALISYS = "cameras_opencv.json", "[!.]*.qca.txt"
_ROUNDING = 1.0  # pixels by which either side of a resized video may be off: encoders want even numbers
_IN_STEP = Clock()
MAX_OFFSET = 1e6  # seconds
_MOST_POINTS = 1_000_000
_OF_FILE = frozenset({"cameras", "points", "made_by", "note", "convention"})
_OF_CAMERA = frozenset({"name", "width", "height", "K", "dist", "R", "t", "video", "offset", "rate"})
_LONGEST_KEY = 40  # characters in a sentence
RATES = 1e-3, 1e3  # slow motion of 240 frames a second that plays at 30 has 0.125


@dataclass(frozen=True, eq=False)
class _Entry:
    """A camera and its lens, its video where the calibration names it, and its clock."""

    calibrated: Calibrated
    video: Path | None = None
    clock: Clock = _IN_STEP

    @property
    def name(self) -> str:
        return self.calibrated[0].name


def matches(path: Path) -> bool:
    """True if the folder holds ``cameras_opencv.json``, or Qualisys' file is that of the project."""
    return _opencv_file(path).is_file() or any(calibrations(path, _QUALISYS, _serials))


def read(path: Path) -> Capture:
    """Open a folder of calibrated videos; ``cameras_opencv.json`` is preferred where both calibrations exist.

    Raises:
        FrogError: if no camera has footage, or a value cannot be used.
    """
    if (calibration := _opencv_file(path)).is_file():
        entries, points, warnings = _opencv_calibration(calibration)
        if not path.is_dir():  # a recording, of which the cameras may have named another
            films = {film.files[0].resolve() for film in recorded(path, [entry.name for entry in entries])}
            others = [entry for entry in entries if entry.video is None or entry.video.resolve() not in films]
            if any(entry.clock != _IN_STEP for entry in others):
                warnings.append(f"{calibration}: offsets and rates are those of other films, and not used.")
            entries = [_Entry(entry.calibrated) if entry in others else entry for entry in entries]
    else:
        calibration = the_calibration(path, _QUALISYS, _serials)
        entries, points, warnings = [_Entry(camera) for camera in read_qualisys(calibration)], None, []
    check_names([entry.name for entry in entries], calibration)
    entries, footage, about = _filmed(path, calibration, entries)
    warnings += about
    cameras = [entry.calibrated for entry in entries]
    if calibration.name != _OPENCV:
        cameras = [_as_counted(*camera, film) for camera, film in zip(cameras, footage, strict=True)]
    clocks = [entry.clock for entry in entries]
    if all(film.is_video for film in footage):
        cameras = [_fitted(camera, film, warnings) for camera, film in zip(cameras, footage, strict=True)]
    elif any(clock != _IN_STEP for clock in clocks):
        warnings.append(f"{calibration}: offsets and rates are those of films; images are paired by their numbers.")
        clocks = []
    return with_points(standing_cameras(path, _LAYOUT, cameras, footage, warnings, clocks), points)


def named_videos(path: Path) -> dict[str, list[Path]]:
    """The files of each camera whose video a folder's calibration names itself; FrogError where it cannot be used."""
    entries, _, _ = _opencv_calibration(path / _OPENCV)
    named = {entry.name: entry.video for entry in entries if entry.video is not None}
    return {name: [*film.files] for name, film in zip(named, footage_of(named.values()), strict=True)}


def _filmed(path: Path, calibration: Path, entries: list[_Entry]) -> tuple[list[_Entry], list[Footage], list[str]]:
    """The cameras that filmed, in the order of their names, with their footage, and warnings; FrogError for none."""
    named = {entry.name: entry.video for entry in entries if entry.video is not None}
    for name, video in named.items():
        if not video.is_file():
            raise found_instead(video, "no file", f"the video of camera {name}, as {calibration.name} says")
    taken = {video.resolve() for video in named.values()}
    names = [entry.name for entry in entries if entry.video is None]
    others = [film for film in recorded(path, names) if film.files[0].resolve() not in taken] if names else []
    filmed, warnings = of_cameras(calibration, names, others) if names else ({}, [])
    shown = zip(named, footage_of(named.values()), strict=True)
    filmed |= {name: replace(film, name=name) for name, film in shown}
    there = sorted((entry for entry in entries if entry.name in filmed), key=lambda entry: entry.name)
    footage = [filmed[entry.name] for entry in there]
    return there, footage, warnings


def _as_counted(camera: Camera, lens: Distortion | None, film: Footage) -> Calibrated:
    """Qualisys' camera at its film's size where that is a pixel less: some files have the size for the last pixel."""
    width, height = film.facts.width, film.facts.height
    is_counted = (width + 1, height + 1) == (camera.width, camera.height)
    return (replace(camera, width=width, height=height) if is_counted else camera), lens


def _opencv_file(path: Path) -> Path:
    """In the capture's folder, or beside the films of a recording that is named among others there."""
    return (path if path.is_dir() else path.parent) / _OPENCV


def _serials(file: Path) -> list[str]:
    return [camera.name for camera, _ in read_qualisys(file)]


def _fitted(calibrated: Calibrated, film: Footage, warnings: list[str]) -> Calibrated:
    """The calibrated camera and lens for the images that a video really has; a warning is added if they differ."""
    camera, lens = as_shown(*calibrated, film.facts)
    before, shown = calibrated[0], (film.facts.width, film.facts.height)
    sizes = f"{film.files[0]}: {shown[0]} x {shown[1]} pixels, calibrated at {before.width} x {before.height}"
    if is_transposed(shown, (camera.width, camera.height)):
        raise FrogError(f"{sizes}, expected the same way up: the film or its calibration is turned by 90 degrees.")
    if is_transposed((before.width, before.height), (camera.width, camera.height)):
        turn = film.facts.turn
        warnings.append(f"{sizes}; taken as calibrated before its rotation flag turned it by {turn} degrees.")
    if shown == (camera.width, camera.height):
        return camera, lens
    wide, high = shown[0] / camera.width, shown[1] / camera.height
    much = abs(wide / high - 1) < 0.01 and abs(wide - 1) > 0.05
    little = wide != 1 and high != 1 and abs(wide - high) <= _ROUNDING / camera.width + _ROUNDING / camera.height
    if much or little:
        warnings.append(f"{sizes}; taken as the same image, resized.")
        return camera.resized(*shown), lens
    if max(shown[0] - camera.width, shown[1] - camera.height) > _ROUNDING:
        expected = "the calibrated image, that image resized, or a part of it: is the film turned?"
        raise FrogError(f"{sizes}, expected {expected}")
    warnings.append(f"{sizes}; taken as its upper left part unless a pixel offset is given.")
    return replace(camera, width=shown[0], height=shown[1]), lens


def _points(path: Path, listed: object) -> Float64s | None:
    """(N, 3) of ``cameras_opencv.json``, as ``frog calibrate`` writes them; None without any."""
    if listed is None or listed == []:
        return None
    count = len(listed) if isinstance(listed, list) else 0
    if count > _MOST_POINTS:
        raise found_instead(path, f"{count:,} points", f"at most {_MOST_POINTS:,}")
    return numbers(listed, (count, 3), path, "points")


def _opencv_calibration(path: Path) -> tuple[list[_Entry], Float64s | None, list[str]]:
    """Cameras of ``cameras_opencv.json``: name, width, height, K, dist (k1 k2 p1 p2 k3), R, t; x_camera = R x + t; its
    points; and a sentence where it has keys that nothing here uses, such as another lens model.

    Optional are video (a path), offset (seconds) and rate.
    """
    content = read_json(path)
    expected = '"cameras": [{"name": ..., "K": ..., "R": ..., "t": ...}, ...]'
    entries = records(content.get("cameras"), path, "cameras", expected)
    cameras: list[_Entry] = []
    unused = content.keys() - _OF_FILE
    for position, entry in enumerate(entries):
        name = "" if entry.get("name") is None else composed(str(entry["name"]))  # which may be the number 0
        if not name:
            raise found_instead(path, f"camera {position} without a name", "the name of its video")
        width, height = (size(entry.get(side), path, f"{side} of camera {name}") for side in ("width", "height"))
        view = opencv_camera(name, (width, height), {key: entry.get(key) for key in ("K", "R", "t", "dist")}, path)
        cameras.append(_Entry(view, _video(entry, path, name), clock_of(entry, path, name)))
        unused |= entry.keys() - _OF_CAMERA
    shown = listed([key[:_LONGEST_KEY] for key in sorted(unused)], 6)
    said = f"{path}: not used: {shown}; every lens is taken for OpenCV's perspective one, which `dist` bends."
    return cameras, _points(path, content.get("points")), [said] if unused else []


def _video(entry: dict[str, object], path: Path, name: str) -> Path | None:
    """The path that an entry names, from the calibration's folder."""
    video = entry.get("video")
    if video is None:
        return None
    if not isinstance(video, str) or not video or "\0" in video or is_network_path(video):
        raise found_instead(path, f"{video!r} as the video of camera {name}", "the path of a file on this computer")
    return path.parent / video


def clock_of(entry: dict[str, object], path: Path, name: str) -> Clock:
    """The clock of a camera in ``cameras_opencv.json``; FrogError for one out of range."""
    offset = number(entry.get("offset", 0.0), path, f"offset of camera {name}", most=MAX_OFFSET)
    rate = number(entry.get("rate", 1.0), path, f"rate of camera {name}", positive=True)
    if not RATES[0] <= rate <= RATES[1]:
        raise found_instead(path, f"rate of camera {name} = {rate:g}", f"{RATES[0]:g} to {RATES[1]:g}")
    return Clock(offset, rate)


_PARTS = ("fov_video", "transform", "intrinsic")  # of a camera that was calibrated
_SUBPIXELS = 64.0  # the file counts pixels in sixty-fourths


def read_qualisys(path: Path) -> list[Calibrated]:
    """The calibrated cameras, in metres and OpenCV's axes, named by their serial; others are left out.

    Raises:
        FrogError: if the file is not such a calibration, or a value is missing.
    """
    check_length(path, "a Qualisys calibration")
    text = path.read_bytes()
    # Entities can blow a small file up or read other files; a calibration needs none (UTF-16 would hide them).
    if b"<!doctype" in text.lower() or b"<!entity" in text.lower() or b"\0" in text:
        raise found_instead(path, "XML with a document type or entities", "a plain Qualisys calibration")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise found_instead(path, f"text that is not XML ({error})", "a Qualisys calibration") from error
    elements = [element for element in root.iter("camera") if all(element.find(part) is not None for part in _PARTS)]
    cameras = [_read_camera(element, path) for element in elements]
    if not cameras:
        raise found_instead(path, "no camera", "a Qualisys calibration with cameras")
    return cameras


def _read_camera(element: ElementTree.Element, path: Path) -> Calibrated:
    name = composed(element.get("serial") or "")
    if not name:
        raise found_instead(path, "a camera without a serial", "a serial that names the camera's video")

    def value(child: str, attribute: str, default: float | None = None) -> float:
        part = element.find(child)
        text = None if part is None else part.get(attribute)
        if text is None and default is not None:
            return default
        return number(None if text is None else np.array(text), path, f"{child} {attribute} of camera {name}")

    left, top = value("fov_video", "left", 0.0), value("fov_video", "top", 0.0)
    width = size(value("fov_video", "right") - left + 1, path, f"the width of camera {name}")
    height = size(value("fov_video", "bottom") - top + 1, path, f"the height of camera {name}")
    intrinsics = np.eye(3)
    for row, axis, start in ((0, "U", left), (1, "V", top)):
        intrinsics[row, row] = value("intrinsic", f"focalLength{axis}") / _SUBPIXELS
        intrinsics[row, 2] = value("intrinsic", f"centerPoint{axis}") / _SUBPIXELS - start
    # The rows are the camera's axes in the world; Qualisys' camera looks along -z with y up.
    rows = np.array([[value("transform", f"r{i}{j}") for j in (1, 2, 3)] for i in (1, 2, 3)])
    world_to_camera = rotation(OPENGL_AXES @ rows, path, f"the rotation of camera {name}")
    center = np.array([value("transform", axis) for axis in "xyz"]) / 1000.0
    terms = (("radial", 1), ("radial", 2), ("tangental", 1), ("tangental", 2), ("radial", 3))
    coefficients = np.array([value("intrinsic", f"{kind}Distortion{i}", 0.0) for kind, i in terms]) / _SUBPIXELS
    camera = Camera(name, width, height, intrinsics, pose(world_to_camera, center))
    return camera, distortion(coefficients)
