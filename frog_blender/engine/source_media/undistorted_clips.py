"""Clips of a capture's cameras as training saw them, for video programs: free of lens distortion, one for each camera.

Needed where lenses distort, where films lack frames, start late or are tone-mapped, or where a video program cannot
read a layout's images as a film (Technicolor's end with the camera's number). They lie in a folder beside the scene's
file, with an index that says what they were made from, and that they are whole.
"""

import json
import os
import tempfile
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ..capture.capture import Capture
from ..capture.decoding import decode_shots
from ..capture.frame_keys import decoding_key, sources_of
from ..capture.media import UPRIGHT, read_film_header, read_photograph
from ..capture.readers import open_capture
from ..capture.video import VIDEO_SUFFIXES, load_opencv, read_facts
from ..errors import FrogError, found_instead
from ..io.atomic_files import write_atomically
from ..io.plain_values import JsonObject, kept_json
from ..scene.header import SceneHeader
from .clips import Clip, camera_path, find_clips

_INDEX = "clips.json"
_PARTIAL = ".partial-"
_ABANDONED_AFTER = 86_400.0  # seconds after which no process writes its films any more


@dataclass(frozen=True)
class Undistortion:
    """Films on their way.

    Attributes:
        total: images to write.
        steps: yields how many are written, after each; closed early it leaves no films. Raises FrogError.
    """

    total: int
    steps: Generator[int, None, None]


def clips_folder(scene_file: Path) -> Path:
    """Where the straight clips of a scene lie, if there are any."""
    return scene_file.with_suffix(".clips")


def undistorted_clips(header: SceneHeader, scene_file: Path) -> dict[str, Clip]:
    """Clips by camera name that were written for this scene; {} where there are none, or not all of them."""
    folder = clips_folder(scene_file)
    if kept_json(folder / _INDEX).get("scene") != _decides(header):
        return {}
    clips = {}
    for name, filmed_frames in _filmed_frames(header).items():
        file = _file(folder, name, len(filmed_frames))
        clips[name] = Clip(file, "VIDEO", count=header.frame_count) if len(filmed_frames) > 1 else Clip(file, "IMAGE")
    return clips if all(clip.path.is_file() for clip in clips.values()) else {}


def undistortion(
    header: SceneHeader, scene_file: Path, capture_folder: Path, *, writing: set[Path] | None = None
) -> Undistortion | None:
    """What has to be written for a video program to show a capture; None where it can as it is, or has been written.

    Args:
        writing: folders whose clips are being written; this scene's is among them while ``steps`` run.

    Raises:
        FrogError: if the capture cannot be opened, is not that of the scene, or something else lies where films go.
    """
    if not os.path.isdir(capture_folder):
        return None
    shown = find_clips(header, capture_folder)
    capture = open_capture(capture_folder, pixel_offsets=header.pixel_offsets or None, layout=header.layout)
    if shown and not any(capture.distortions) and _is_shown_as_filmed(capture):
        return None
    films = _films(header, capture, capture_folder)
    folder, seen = clips_folder(scene_file), _at_size(capture, header)
    key = decoding_key(seen, sources_of(seen))
    if kept_json(folder / _INDEX).get("made_from") == key and undistorted_clips(header, scene_file):
        return None
    writing = set() if writing is None else writing
    if folder in writing:
        raise FrogError(f"{folder}: the clips are being written already.")
    if folder.is_symlink() or _holds_others(folder):  # a link leads where nobody asked to write
        raise FrogError(f"{folder}: found files of others, expected this name to be free for them.")
    marks = {"scene": _decides(header), "made_from": key}
    return Undistortion(sum(map(len, films.values())), _write(header, seen, films, folder, marks, writing))


def _is_shown_as_filmed(capture: Capture) -> bool:
    """False where a film's images do not follow the capture's frames one by one or are changed when decoded, or where
    images are turned by their EXIF, which not every program obeys."""
    films = {shot.path for shot in capture.shots if shot.path.suffix.lower() in VIDEO_SUFFIXES}
    if any(shot.path in films and shot.index != shot.frame for shot in capture.shots):
        return False
    headers = map(read_film_header, films)
    if any(header.transfer or header.fields or header.aspect != 1 or header.is_untimed for header in headers):
        return False
    photographs = map(read_photograph, {shot.path for shot in capture.shots} - films)
    return all(photograph is None or photograph.orientation == UPRIGHT for photograph in photographs)


def _holds_others(folder: Path) -> bool:
    """True unless there is an index, or nothing at all in a folder, or of that name, but films that were begun."""
    if not folder.is_dir():
        return folder.exists()
    is_ours = (folder / _INDEX).exists()
    return not is_ours and any(not entry.name.startswith(_PARTIAL) for entry in folder.iterdir())


def _films(header: SceneHeader, capture: Capture, folder: Path) -> dict[str, list[int]]:
    """The shots of each clip, ordered by frame; FrogError where the capture is not that of the scene."""
    if capture.frame_count != header.frame_count:
        raise found_instead(
            folder, f"{capture.frame_count} frames", f"{header.frame_count} as the scene was trained on"
        )
    index = {camera.name: i for i, camera in enumerate(capture.cameras)}
    films = {}
    for name, filmed_frames in _filmed_frames(header).items():
        shots = [capture.shot_index(index.get(camera, -1), frame) for frame, camera in filmed_frames]
        films[name] = [shot for shot in shots if shot is not None]
        if not shots or None in shots:
            raise FrogError(f"{folder}: not all images of {name} are there, expected those that were trained on.")
    return films


def _filmed_frames(header: SceneHeader) -> dict[str, list[tuple[int, str]]]:
    """By the camera that shows each clip: the frames that were filmed, and by which camera."""
    if header.is_moving:
        path = [(frame, camera.name) for frame, camera in camera_path(header)]
        return {path[0][1]: path}
    filmed = zip(header.cameras, header.camera_shots, strict=True)
    return {camera.name: [(frame, camera.name) for frame in sorted(frames)] for camera, frames in filmed}


def _at_size(capture: Capture, header: SceneHeader) -> Capture:
    """The capture at the size that was trained at; videos have even sides."""
    sizes = {camera.name: (camera.width, camera.height) for camera in header.cameras}
    cameras = []
    for camera in capture.cameras:
        width, height = sizes.get(camera.name, (camera.width, camera.height))
        cameras.append(camera.resized(width + width % 2, height + height % 2))
    return capture.with_cameras(cameras)


def _decides(header: SceneHeader) -> JsonObject:
    """What of a scene decides its clips, as it is kept beside them."""
    lenses = {camera.name: np.round(camera.intrinsics, 6).tolist() for camera in header.cameras}
    return {"capture": header.capture_path, "frames": header.frame_count, "lenses": lenses}


def _file(folder: Path, name: str, count: int) -> Path:
    """The file of a camera's clip of ``count`` frames. Cameras' names may hold slashes, files' may not."""
    return folder / f"{quote(name, safe=' ')}.{'mp4' if count > 1 else 'png'}"


def _write(
    header: SceneHeader,
    capture: Capture,
    films: Mapping[str, Sequence[int]],
    folder: Path,
    marks: JsonObject,
    writing: set[Path],
) -> Generator[int, None, None]:
    """Films into the folder, whose index says nothing until all of them are whole.

    They are written into a new folder in there and then put in their places: the folder may have come with the scene,
    and under a film's name it may hold a link to anything.
    """
    done, index = 0, folder / _INDEX
    files = {name: _file(folder, name, len(shots)) for name, shots in films.items()}
    writing.add(folder)
    try:
        folder.mkdir(exist_ok=True)
        _remove_abandoned(folder)
        with tempfile.TemporaryDirectory(prefix=_PARTIAL, dir=folder, ignore_cleanup_errors=True) as partial:
            for name, shots in films.items():
                new, rate = Path(partial, files[name].name), round(header.frames_per_second) or 1
                for _ in _write_clip(new, rate, capture, shots):
                    done += 1
                    yield done
            try:
                write_atomically(index, b"{}")
                for file in files.values():
                    os.replace(Path(partial, file.name), file)  # of a link the link itself
                write_atomically(index, json.dumps(marks).encode())
            except BaseException:
                for file in (*files.values(), index):
                    with suppress(OSError):  # the next ones go nevertheless, and the first error is told
                        file.unlink(missing_ok=True)
                raise
    except OSError as error:
        where = error.filename2 or folder  # of what is put in its place, the place
        raise FrogError(f"{where}: the clips cannot be written here ({error.strerror or error}).") from error
    finally:
        writing.discard(folder)
        with suppress(OSError):
            os.rmdir(folder)  # unless there is something in it


def _remove_abandoned(folder: Path) -> None:
    """What processes left that were killed while they wrote films."""
    for partial in folder.glob(f"{_PARTIAL}*"):
        with suppress(OSError):
            if time.time() - partial.lstat().st_mtime > _ABANDONED_AFTER and not partial.is_symlink():
                for film in (*partial.glob("*.mp4"), *partial.glob("*.png")):
                    film.unlink()
                partial.rmdir()  # unless there is something else in it


def _write_clip(path: Path, rate: int, capture: Capture, shots: Sequence[int]) -> Generator[None, None, None]:
    """One camera's shots, ordered by frame: an image, or a video of all times that repeats one where one lacks.

    Whoever shows it asks for images by number, so a whole rate will do; MPEG-4 cannot say every other.
    """
    cv2 = load_opencv()
    images = (cv2.cvtColor(image, cv2.COLOR_RGB2BGR) for image in decode_shots(capture, shots))
    if len(shots) == 1:
        path.write_bytes(cv2.imencode(".png", next(images))[1].tobytes())
        yield
        return
    camera = capture.cameras[capture.shots[shots[0]].camera]
    size = (camera.width, camera.height)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), float(rate), size)
    try:
        if not video.isOpened():
            raise FrogError(f"{path}: OpenCV cannot write this video (no encoder for MPEG-4, or no room).")
        changes = [capture.shots[shot].frame for shot in shots[1:]]
        for image, first, end in zip(images, [0, *changes], [*changes, capture.frame_count], strict=True):
            shown = image if image.shape[1::-1] == size else cv2.resize(image, size)
            for _ in range(first, end):
                video.write(shown)
            yield
    finally:
        video.release()
    try:
        written = read_facts(path).frame_count
    except FrogError:
        written = 0
    if written != capture.frame_count:  # an encoder does not say that a disk is full
        raise FrogError(f"{path}: {written} of {capture.frame_count} images could be written; is the disk full?")
