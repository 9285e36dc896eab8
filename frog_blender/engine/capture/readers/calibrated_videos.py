"""Synchronised videos and a calibration: ``cameras_opencv.json`` or Qualisys' ``*.qca.txt``.

A video, or a folder of frames, belongs to the calibrated camera of its name (``cam01.mp4`` to ``cam01``). Nothing is
held out.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import FrogError, found_instead
from ..camera import Camera
from ..capture import Capture, Distortion
from ..video import VideoFacts, composed, find_videos, read_facts
from . import qualisys
from .assembly import standing_cameras
from .checks import numbers, pinhole, read_json, rotation, shared_frame_count, shots_of_videos, size
from .footage import Footage, find_footage, of_cameras
from .geometry import distortion

_OPENCV = "cameras_opencv.json"
_ROUNDING = 1.0  # pixels by which either side of a resized video may be off: encoders want even numbers


def matches(path: Path) -> bool:
    """True if the folder holds one of the calibrations."""
    return (path / _OPENCV).is_file() or bool(_qualisys_files(path))


def read(path: Path) -> Capture:
    """Open a folder of calibrated videos; ``cameras_opencv.json`` is preferred where both calibrations exist.

    Raises:
        FrogError: if a camera lacks its video or a video its camera, or a value cannot be used.
    """
    if (path / _OPENCV).is_file():
        calibration = path / _OPENCV
        calibrated = _read_opencv(calibration)
    else:
        calibration = _qualisys_files(path)[0]
        calibrated = qualisys.read_cameras(calibration)
    calibrated = [(replace(camera, name=composed(camera.name)), lens) for camera, lens in calibrated]
    names = [camera.name for camera, _ in calibrated]
    if len(set(names)) != len(names):
        raise found_instead(calibration, f"several cameras named {max(names, key=names.count)}", "one of each name")
    files = find_videos(path)
    if not files and (frames := find_footage(path)):
        return _of_frames(path, calibration, calibrated, frames)
    stems = [composed(video.stem) for video in files]
    videos = dict(zip(stems, files, strict=True))
    if len(videos) != len(files):
        raise found_instead(path, f"several videos named {max(stems, key=stems.count)}", "one video for each camera")
    _match_names(path, calibration, set(names), set(videos))
    calibrated.sort(key=lambda entry: entry[0].name)
    paths = [videos[camera.name] for camera, _ in calibrated]
    facts = [read_facts(video) for video in paths]
    frame_count, warnings = shared_frame_count(path, paths, facts)
    cameras = []
    for (camera, _), video, fact in zip(calibrated, paths, facts, strict=True):
        fitted, warning = _fit_to_video(camera, video, fact)
        cameras.append(fitted)
        warnings += [warning] if warning else []
    return Capture(
        path=path,
        format="calibrated_videos",
        cameras=tuple(cameras),
        distortions=tuple(lens for _, lens in calibrated),
        shots=shots_of_videos(paths, frame_count),
        frame_count=frame_count,
        frames_per_second=facts[0].frames_per_second,
        warnings=tuple(warnings),
    )


def _of_frames(
    path: Path, calibration: Path, calibrated: list[tuple[Camera, Distortion | None]], frames: list[Footage]
) -> Capture:
    """Folders of frames instead of videos."""
    cameras = {camera.name: (camera, lens) for camera, lens in calibrated}
    found, warnings = of_cameras(calibration, sorted(cameras), frames)
    chosen = [cameras[name] for name in found]
    return standing_cameras(path, "calibrated_videos", chosen, list(found.values()), warnings)


def _qualisys_files(path: Path) -> list[Path]:
    """Calibrations by Qualisys; hidden files do not count."""
    return sorted(file for file in path.glob("*.qca.txt") if not file.name.startswith("."))


def _match_names(path: Path, calibration: Path, cameras: set[str], videos: set[str]) -> None:
    """Raise unless every camera has its video and every video its camera."""
    if not videos:
        raise found_instead(path, f"{calibration.name} and no video", f"videos named {', '.join(sorted(cameras))}")
    if cameras - videos:
        lacking = ", ".join(sorted(cameras - videos))
        raise FrogError(
            f"{path}: {calibration.name} has camera {lacking} without a video, expected {lacking}.mp4 beside it."
        )
    if videos - cameras:
        extra = ", ".join(sorted(videos - cameras))
        raise FrogError(f"{path}: video {extra} has no camera in {calibration.name}, expected one of that name.")


def _fit_to_video(camera: Camera, video: Path, facts: VideoFacts) -> tuple[Camera, str | None]:
    """The calibrated camera for the images that the video really has, and a warning if they differ."""
    if (facts.width, facts.height) == (camera.width, camera.height):
        return camera, None
    sizes = f"{video}: {facts.width} x {facts.height} pixels, calibrated at {camera.width} x {camera.height}"
    wide, high = facts.width / camera.width, facts.height / camera.height
    much = abs(wide / high - 1) < 0.01 and abs(wide - 1) > 0.05
    little = wide != 1 and high != 1 and abs(wide - high) <= _ROUNDING / camera.width + _ROUNDING / camera.height
    if much or little:
        return camera.resized(facts.width, facts.height), f"{sizes}; taken as the same image, resized."
    return (
        replace(camera, width=facts.width, height=facts.height),
        f"{sizes}; taken as its upper left part unless a pixel offset is given.",
    )


def _read_opencv(path: Path) -> list[tuple[Camera, Distortion | None]]:
    """Cameras of ``cameras_opencv.json``: name, width, height, K, dist (k1 k2 p1 p2 k3), R, t; x_camera = R x + t."""
    entries = read_json(path).get("cameras")
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise found_instead(path, "no list of cameras", '"cameras": [{"name": ..., "K": ..., "R": ..., "t": ...}, ...]')
    cameras: list[tuple[Camera, Distortion | None]] = []
    for position, entry in enumerate(entries):
        name = "" if entry.get("name") is None else str(entry["name"])  # which may be the number 0
        if not name:
            raise found_instead(path, f"camera {position} without a name", "the name of its video")
        intrinsics = pinhole(entry.get("K"), path, f"K of camera {name}")
        world_to_camera = np.eye(4)
        matrix = numbers(entry.get("R"), (3, 3), path, f"R of camera {name}")
        world_to_camera[:3, :3] = rotation(matrix, path, f"the rotation of camera {name}")
        world_to_camera[:3, 3] = numbers(entry.get("t"), (3,), path, f"t of camera {name}")
        listed = entry.get("dist") or []
        count = len(listed) if isinstance(listed, list) else 0
        coefficients = numbers(listed, (count,), path, f"dist of camera {name}")
        if count not in (0, 4, 5, 8, 12, 14):  # what OpenCV takes
            raise found_instead(path, f"{count} distortion coefficients for camera {name}", "4, 5, 8, 12 or 14")
        width = size(entry.get("width"), path, f"width of camera {name}")
        height = size(entry.get("height"), path, f"height of camera {name}")
        cameras.append((Camera(name, width, height, intrinsics, world_to_camera), distortion(coefficients)))
    return cameras
