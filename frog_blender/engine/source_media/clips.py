"""Where the images lie that a scene's cameras took: found again by the header. Of the common layouts nothing is
opened or decoded.

Video programs name an image by one number. A video's first frame is number 1; a sequence of image files is numbered
by the last digits in the files' names. A clip says how that number follows from the capture's frame.
"""

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from ..capture.camera import Camera
from ..capture.readers import calibrated_videos, open_capture, transforms_json
from ..capture.readers.chapters import films_of
from ..capture.video import VIDEO_SUFFIXES, composed, find_images, find_videos
from ..errors import FrogError
from ..io.paths import is_network_path
from ..scene.header import SceneHeader

_NUMBER = re.compile(r"(\D*(?:\d+\D+)*?)(\d+)(\D*)")  # the last digits of a name, and what stands around them


@dataclass(frozen=True)
class Clip:
    """What one camera filmed.

    Attributes:
        path: the video, or the first image.
        kind: "VIDEO", "SEQUENCE" of numbered images, or "IMAGE".
        first: number of the image that shows the capture's frame 0.
        step: how much that number grows from one frame of the capture to the next.
        count: frames of the capture.
    """

    path: Path
    kind: str
    first: int = 1
    step: int = 1
    count: int = 1


def capture_folders(header: SceneHeader, scene_file: Path) -> list[Path]:
    """Folders in which a scene's capture may lie, the likeliest first: as stored, then near the scene's own file.

    A stored path to another machine is left out: nothing that a file says may make a computer call others.
    """
    stored = header.capture_path
    name = PureWindowsPath(stored).name  # of paths with either kind of stroke
    nearby = [scene_file.parent / name, scene_file.parent, scene_file.parent.parent / name] if name else []
    return [Path(stored), *nearby] if stored and not is_network_path(stored) else nearby


def find_clips(header: SceneHeader, folder: Path) -> dict[str, Clip]:
    """Clips by camera name, of the cameras whose images are in a capture's folder; {} where there is none.

    The path of one moving camera has the name of its first image's camera (see ``camera_path``).
    """
    try:
        stored = _files(header, folder) if folder.is_dir() else {}
    except (FrogError, OSError):
        return {}
    named = {composed(name): paths for name, paths in stored.items()}
    files = {camera.name: named.get(composed(camera.name), []) for camera in header.cameras}
    if header.is_moving:
        path = [(frame, camera.name) for frame, camera in camera_path(header)]
        shown = [(frame, of[0]) for frame, name in path if (of := files[name])]
        clip = _sequence(shown, header.frame_count)
        return {path[0][1]: clip} if clip is not None else {}
    clips = {}
    for camera, frames in zip(header.cameras, header.camera_shots, strict=True):
        of = files[camera.name]
        sequence = None
        if len(of) == len(frames):  # a standing camera's
            sequence = _sequence(list(zip(sorted(frames), of, strict=True)), header.frame_count)
        is_video = bool(of) and of[0].suffix.lower() in VIDEO_SUFFIXES
        if of and not (is_video and len(of) > 1):  # no video program shows chapters as one film
            alone = Clip(of[0], "VIDEO", count=header.frame_count) if is_video else Clip(of[0], "IMAGE")
            clips[camera.name] = sequence or alone
    return clips


def camera_path(header: SceneHeader) -> list[tuple[int, Camera]]:
    """Frames of a moving camera in order, with the camera there; training images go before held-out ones."""
    by_frame: dict[int, Camera] = {}
    for camera, frames in zip(header.cameras, header.camera_shots, strict=True):
        for frame in frames:
            if frame not in by_frame or by_frame[frame].name in header.test_cameras:
                by_frame[frame] = camera
    return sorted(by_frame.items(), key=lambda entry: entry[0])


def _files(header: SceneHeader, folder: Path) -> dict[str, list[Path]]:
    """The video, or the images in order of time, of each camera by its name, as the reader of that format named
    them."""
    match header.capture_format:
        case "n3dv" | "calibrated_videos":
            videos = {files[0].stem: [*files] for files in films_of(find_videos(folder))}
            with suppress(FrogError):  # where there is no calibration, or none that can be read
                videos |= calibrated_videos.named_videos(folder)
            return videos or _by_stem(folder / "images") or _of_capture(folder, header.layout)
        case "transforms":
            return transforms_json.images_by_camera(folder) if transforms_json.matches(folder) else {}
        case "hypernerf":
            folders = [folder / "rgb" / "2x", *sorted((folder / "rgb").glob("*x"))]
            return next(filter(None, map(_by_stem, folders)), {})
        case "technicolor":
            return {}  # its images' names end with the camera's number: no program takes them for a sequence
    return _of_capture(folder, header.layout)


def _of_capture(folder: Path, layout: str) -> dict[str, list[Path]]:
    """The files of each camera as its reader finds them, in order of time."""
    capture = open_capture(folder, layout=layout)
    files: dict[str, dict[Path, None]] = {}
    for shot in capture.shots:
        files.setdefault(capture.cameras[shot.camera].name, {})[shot.path] = None
    return {name: list(of) for name, of in files.items()}


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    return {image.stem: [image] for image in find_images(folder)}


def _sequence(files: list[tuple[int, Path]], count: int) -> Clip | None:
    """Images by frame as one sequence; None where their numbers do not follow the frames in equal steps."""
    named = [(frame, file, match) for frame, file in files if (match := _NUMBER.fullmatch(file.stem))]
    around = {(file.parent, match[1], match[3], file.suffix) for _, file, match in named}
    if len(named) < max(len(files), 2) or len(around) > 1:
        return None
    (start, path, low), (end, _, high) = named[0], named[-1]
    step = (int(high[2]) - int(low[2])) // (end - start)
    first = int(low[2]) - step * start
    if any(match[2] != f"{first + step * frame:0{len(low[2])}d}" for frame, _, match in named):
        return None
    return Clip(path, "SEQUENCE", first, step, count)
