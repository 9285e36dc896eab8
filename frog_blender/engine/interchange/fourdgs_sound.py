"""The sound of a ``.4dgs`` file, kept in a file beside the scene that it becomes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FrogError
from ..io.atomic_files import write_atomically
from ..source_media.sound_beside import sound_beside, suffix_of
from .fourdgs_source import reading


@dataclass(frozen=True)
class _Sound:
    """Attributes:
    content: of a sound file, as it stands in the ``.4dgs``.
    start: seconds of the take at which it begins.
    others: how many sounds the file has besides.
    """

    content: bytes
    start: float
    others: int


def keep_sound(source: Path, scene_file: Path) -> str:
    """Writes the first sound of ``source`` beside a scene; sentences about what of its sounds was left out.

    A file that is there already and is another one stays.
    """
    try:
        with reading(source):
            sound = _first_sound(source.read_bytes())
        if sound is None:
            return ""
        suffix, there = suffix_of(sound.content), sound_beside(scene_file)
        if suffix is None:
            return "Its sound was left out: it is in a form that is not known."
        if sound.start:
            return f"Its sound was left out: it begins {sound.start:g} seconds after the first frame."
        if there is not None and there.read_bytes() != sound.content:
            return f"Its sound was left out: {there.name} is there already."
        if there is None:
            write_atomically(scene_file.with_suffix(suffix), sound.content)
    except (FrogError, OSError) as error:
        return f"Its sound was left out: {error}"
    if sound.others:
        return f"It has {sound.others + 1} sounds: the first one is heard from everywhere, the others were left out."
    return ""


def _first_sound(content: bytes) -> _Sound | None:
    from fourdgs import opcode as op
    from fourdgs import records as rec
    from fourdgs.serialization import MAGIC, iter_records

    described: list[Any] = []  # of fourdgs, which has no types
    contents: dict[int, bytes] = {}
    for record in iter_records(content, len(MAGIC)):
        if record.opcode == op.AUDIO:
            old = rec.Audio.parse(record.content)
            return _Sound(bytes(old.data), float(old.start_sec), 0)
        if record.opcode == op.AUDIO_SOURCE:
            described.append(rec.AudioSource.parse(record.content))
        elif record.opcode == op.AUDIO_DATA:
            data = rec.AudioData.parse(record.content)
            contents[data.source_id] = bytes(data.data)
    if not described:
        return None
    first = described[0]
    return _Sound(contents[first.source_id], float(first.start_sec), len(described) - 1)
