"""Where a scene's sound is: in a film of its capture or in a file beside it; and when in it the capture begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..capture.movie_header import read_movie_header
from ..capture.readers import open_capture
from ..capture.video import frame_rate
from ..errors import FrogError
from ..scene.header import SceneHeader
from .clips import capture_folders, find_clips
from .sound import has_sound as ffmpeg_has_sound
from .sound_beside import sound_beside


@dataclass(frozen=True)
class FilmSound:
    """A film that has sound, or a file of sound.

    Attributes:
        path: of the film.
        start: its second that the capture's frame 0 shows; negative if it began to film later.
    """

    path: Path
    start: float


def find_sound(
    header: SceneHeader, scene_file: Path, has_sound: Callable[[Path], bool] = ffmpeg_has_sound
) -> FilmSound | None:
    """The first film of a capture that has sound, else the file of that name beside the scene; None for silence."""
    for folder in capture_folders(header, scene_file):
        clips = find_clips(header, folder)
        for clip in clips.values():
            if clip.kind == "VIDEO" and has_sound(clip.path):
                return FilmSound(clip.path, _start_of(folder, clip.path))
        if clips:
            break
    beside = sound_beside(scene_file)
    return FilmSound(beside, 0.0) if beside is not None and has_sound(beside) else None


def _start_of(folder: Path, film: Path) -> float:
    """By an image of the film that the capture has; 0 where the capture cannot be read any more."""
    try:
        capture = open_capture(folder)
        shot = next((shot for shot in capture.shots if shot.path == film), None)
        return (
            0.0
            if shot is None
            else _second_of(film, shot.index) - (shot.frame + shot.offset) / capture.frames_per_second
        )
    except (FrogError, ImportError):
        return 0.0


def _second_of(film: Path, index: int) -> float:
    """At which a film shows an image."""
    header = read_movie_header(film)
    if header is not None and header.timestamps is not None and index < len(header.timestamps):
        return float(header.timestamps[index])
    return (header.start if header is not None else 0.0) + index / frame_rate(film)
