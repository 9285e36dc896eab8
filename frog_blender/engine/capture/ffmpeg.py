"""The ffmpeg program of imageio-ffmpeg, where that is installed: sound, and what it says of a film."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

_LONGEST_NOTES = 200_000  # characters
_PATIENCE = 30.0  # seconds in which ffmpeg must say what a file holds


def program() -> str | None:
    """The path of ffmpeg; None where imageio-ffmpeg is not installed or has none for this machine."""
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return None


def whole_path(path: Path) -> str:
    """A file as ffmpeg takes it: without this, what stands before a colon in a name is a protocol."""
    return "file:" + os.path.abspath(path)


def notes(path: Path, patience: float = _PATIENCE) -> str:
    """What ffmpeg says about a file within so many seconds: streams, tags, timecodes; "" where there is no ffmpeg or it
    fails."""
    ffmpeg = program()
    if ffmpeg is None:
        return ""
    command = [ffmpeg, "-hide_banner", "-nostdin", "-protocol_whitelist", "file", "-i", whole_path(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=patience, check=False)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stderr.decode(errors="replace")[:_LONGEST_NOTES]
