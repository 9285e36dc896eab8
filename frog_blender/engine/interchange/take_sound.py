"""The sound of a scene's capture: the first of its films that has a track of sound."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from ..capture.ffmpeg import notes, program, whole_path
from ..errors import FrogError, brief
from ..scene.header import SceneHeader
from ..source_media.clips import capture_folders, find_clips
from .take import Sound

_TRACK = re.compile(r"Stream #\d+:\d+.*: Audio: ")
_PATIENCE = 120.0  # seconds in which ffmpeg must write a sound
_RATE, _QUALITY = 48_000, "96k"


def has_sound(path: Path) -> bool:
    """Whether a film has a track of sound; False as well where there is no ffmpeg to tell."""
    return bool(_TRACK.search(notes(path)))


def sound_of(header: SceneHeader, scene_file: Path, frame: float = 0.0) -> Sound | None:
    """What was heard at a frame of the capture, counted from 0, and after it; None where no film with sound is found.

    Films are taken to begin with the capture's first frame.
    """
    for folder in capture_folders(header, scene_file):
        clips = find_clips(header, folder)
        for clip in clips.values():
            if clip.kind == "VIDEO" and has_sound(clip.path):
                return Sound(clip.path, frame / header.frames_per_second)
        if clips:
            return None
    return None


def encoded(sound: Sound, seconds: float) -> bytes:
    """The sound as Opus in Ogg, stereo, so many seconds of it; FrogError where ffmpeg is missing or fails."""
    ffmpeg = program()
    if ffmpeg is None:
        raise FrogError(f"{sound.path}: writing its sound needs the Python package 'imageio-ffmpeg', found none.")
    command = [ffmpeg, "-v", "error", "-nostdin", "-protocol_whitelist", "file,pipe", "-ss", f"{sound.start:.6f}"]
    command += ["-i", whole_path(sound.path), "-t", f"{seconds:.6f}", "-vn", "-ac", "2", "-ar", str(_RATE)]
    command += ["-c:a", "libopus", "-b:a", _QUALITY, "-fflags", "+bitexact", "-f", "ogg", "pipe:1"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_PATIENCE, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        raise FrogError(f"{sound.path}: its sound could not be read ({brief(error)}).") from error
    if done.returncode or not done.stdout:
        reason = brief(done.stderr.decode(errors="replace")).rstrip(".") or "ffmpeg wrote nothing"
        raise FrogError(f"{sound.path}: its sound could not be read ({reason}).")
    return done.stdout
