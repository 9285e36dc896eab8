"""A sound file beside a scene, of the scene's name: ``take.ogg`` is what is heard with ``take.frog``."""

from __future__ import annotations

from pathlib import Path

SUFFIXES = (".ogg", ".opus", ".wav", ".flac", ".mp3", ".m4a")
_BEGINNINGS = {b"OggS": ".ogg", b"RIFF": ".wav", b"fLaC": ".flac", b"ID3": ".mp3", b"\xff\xfb": ".mp3"}
_MP4 = b"ftyp"  # from the fifth byte on


def sound_beside(scene_file: Path) -> Path | None:
    """The file of a scene's sound; None where there is none."""
    named = (scene_file.with_suffix(suffix) for suffix in SUFFIXES)
    return next((path for path in named if path.is_file()), None)


def suffix_of(content: bytes) -> str | None:
    """The ending of a file of that content; None where it begins like none of SUFFIXES."""
    if content[4:8] == _MP4:
        return ".m4a"
    return next((suffix for beginning, suffix in _BEGINNINGS.items() if content.startswith(beginning)), None)
