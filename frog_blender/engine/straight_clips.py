"""Films of a capture's cameras as training saw them, for video programs: free of lens distortion, one for each camera.

Needed where lenses distort, or where a video program cannot read a layout's pictures as a film (Technicolor's end with
the camera's number). They lie in a folder beside the scene's file, which appears when all of them are whole.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from .capture.decoding import decode_shots
from .capture.readers import open_capture
from .capture.video import load_opencv, read_facts
from .clips import Clip, camera_path, find_clips, moves_alone
from .errors import FrogError

if TYPE_CHECKING:
    from .capture.capture import Capture
    from .files import SceneHeader

_INDEX = "clips.json"
_NEVER_DISTORTED = frozenset({"n3dv"})  # formats that know no distortion, of which many captures are: not even opened


@dataclass(frozen=True)
class Straightening:
    """Films on their way.

    Attributes:
        total: pictures to write.
        steps: yields how many are written, after each; closed early it leaves nothing behind. Raises FrogError.
    """

    total: int
    steps: Generator[int, None, None]


def clips_folder(scene_file: Path) -> Path:
    """Where the straight clips of a scene lie, if there are any."""
    return scene_file.with_suffix(".clips")


def straight_clips(header: SceneHeader, scene_file: Path) -> dict[str, Clip]:
    """Clips by camera name that were written for this scene; {} where there are none, or those of other cameras."""
    folder = clips_folder(scene_file)
    try:
        if json.loads((folder / _INDEX).read_text(encoding="utf-8")) != _decides(header):
            return {}
    except (OSError, ValueError):
        return {}
    clips = {}
    for name, moments in _moments(header).items():
        file = _file(folder, name, len(moments))
        clip = Clip(file, "VIDEO", count=header.frame_count) if len(moments) > 1 else Clip(file, "PICTURE")
        if file.is_file():
            clips[name] = clip
    return clips


def straightening(header: SceneHeader, scene_file: Path, folder: Path) -> Straightening | None:
    """What has to be written for a video program to show the capture in ``folder``; None where it can as it is.

    Raises:
        FrogError: if the capture cannot be opened, or has not got the pictures of this scene.
    """
    if not folder.is_dir() or straight_clips(header, scene_file):
        return None
    shown = find_clips(header, folder)
    if shown and header.capture_format in _NEVER_DISTORTED:
        return None
    capture = open_capture(folder, pixel_offsets=header.pixel_offsets or None)
    if shown and not any(capture.distortions):
        return None
    clips = _moments(header).items()
    films = {name: shots for name, moments in clips if (shots := _shots(capture, moments))}
    if not films:
        raise FrogError(f"{folder}: found none of the pictures that {scene_file.name} was trained from.")
    total = sum(len(shots) for shots in films.values())
    return Straightening(total, _write(header, _at_size(capture, header), films, clips_folder(scene_file)))


def _moments(header: SceneHeader) -> dict[str, list[tuple[int, str]]]:
    """For each clip, by the camera that it is shown behind: the moments that were filmed, and by which camera."""
    if moves_alone(header):
        path = [(frame, camera.name) for frame, camera in camera_path(header)]
        return {path[0][1]: path}
    filmed = zip(header.cameras, header.camera_shots, strict=True)
    return {camera.name: [(frame, camera.name) for frame in sorted(frames)] for camera, frames in filmed}


def _shots(capture: Capture, moments: Sequence[tuple[int, str]]) -> list[int]:
    """The shots of a capture that show these moments, none where it has not got all of them."""
    index = {camera.name: i for i, camera in enumerate(capture.cameras)}
    found = [capture.shot_index(index[name], frame) if name in index else None for frame, name in moments]
    shots = [shot for shot in found if shot is not None]
    return shots if len(shots) == len(moments) else []


def _at_size(capture: Capture, header: SceneHeader) -> Capture:
    """The capture at the size that was trained at; videos have even sides."""
    sizes = {camera.name: (camera.width, camera.height) for camera in header.cameras}
    cameras = []
    for camera in capture.cameras:
        width, height = sizes.get(camera.name, (camera.width, camera.height))
        cameras.append(camera.resized(width + width % 2, height + height % 2))
    return capture.with_cameras(cameras)


def _decides(header: SceneHeader) -> dict[str, Any]:
    """What of a scene decides its clips, as it is kept beside them."""
    lenses = {camera.name: np.round(camera.intrinsics, 6).tolist() for camera in header.cameras}
    return {"capture": header.capture_path, "frames": header.frame_count, "lenses": lenses}


def _file(folder: Path, name: str, count: int) -> Path:
    """The file of a camera's clip of so many moments. Names of cameras may hold strokes, files' may not."""
    return folder / f"{quote(name, safe=' ')}.{'mp4' if count > 1 else 'png'}"


def _write(
    header: SceneHeader, capture: Capture, films: dict[str, list[int]], folder: Path
) -> Generator[int, None, None]:
    done = 0
    partial = None
    try:
        partial = Path(tempfile.mkdtemp(prefix=f"{folder.name}.", dir=folder.parent))
        for name, shots in films.items():
            for _ in _write_clip(_file(partial, name, len(shots)), header, capture, shots):
                done += 1
                yield done
        (partial / _INDEX).write_text(json.dumps(_decides(header)), encoding="utf-8")
        shutil.rmtree(folder, ignore_errors=True)
        partial.rename(folder)
    except OSError as error:
        raise FrogError(f"{folder}: the clips cannot be written here ({error.strerror or error}).") from error
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)


def _write_clip(path: Path, header: SceneHeader, capture: Capture, shots: Sequence[int]) -> Generator[None, None, None]:
    """One camera's shots, ordered by frame: a picture, or a video of all moments that repeats one where one lacks."""
    cv2 = load_opencv()
    pictures = (cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) for picture in decode_shots(capture, shots))
    if len(shots) == 1:
        path.write_bytes(cv2.imencode(".png", next(pictures))[1].tobytes())
        yield
        return
    camera = capture.cameras[capture.shots[shots[0]].camera]
    size = (camera.width, camera.height)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), header.frames_per_second, size)
    try:
        if not video.isOpened():
            raise FrogError(f"{path.parent}: no video can be written here (no encoder in OpenCV, or no room).")
        changes = [capture.shots[shot].frame for shot in shots[1:]]
        for picture, first, end in zip(pictures, [0, *changes], [*changes, header.frame_count], strict=True):
            shown = picture if picture.shape[1::-1] == size else cv2.resize(picture, size)
            for _ in range(first, end):
                video.write(shown)
            yield
    finally:
        video.release()
    if read_facts(path).frame_count != header.frame_count:  # an encoder does not say that a disk is full
        raise FrogError(f"{path.parent}: a clip could not be written whole, expected room for it.")
