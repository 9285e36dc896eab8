"""Timecodes and creation times: a window to search for lags in, never an answer.

A timecode has whole frames and free-running clocks; a creation time has whole seconds, is the end of the recording on
some phones, and the time of export on all computers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)[:;.](\d\d)")
_CREATED = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?)Z?")
_TIMECODE_SLACK, _CREATED_SLACK = 1.0, 3.0  # seconds
_DAY = 86_400.0


@dataclass(frozen=True)
class Note:
    """When a film says it started: seconds of a day's timecode or since 1970, and of which kind it is."""

    seconds: float
    is_timecode: bool


def read_note(tags: Mapping[str, str], frames_per_second: float) -> Note | None:
    """The start that a film's tags tell; None if they tell none."""
    if found := _TIMECODE.fullmatch(tags.get("timecode", "")):
        hours, minutes, seconds, frames = (int(part) for part in found.groups())
        whole = 3600 * hours + 60 * minutes + seconds
        return Note(whole + frames / max(frames_per_second, 1.0), True)
    if found := _CREATED.fullmatch(tags.get("creation_time", "")):
        try:
            created = datetime.fromisoformat(found[1] + "+00:00")
        except ValueError:
            return None
        # Cameras that know no time write the year their clock starts with.
        return Note(created.timestamp(), False) if created.year > 2000 else None
    return None


def window(first: Note | None, second: Note | None) -> tuple[float, float] | None:
    """The least and the greatest lag between two films, seconds; None where their notes do not tell."""
    if first is None or second is None or first.is_timecode != second.is_timecode:
        return None
    lag = second.seconds - first.seconds
    if first.is_timecode:
        lag = (lag + _DAY / 2) % _DAY - _DAY / 2
    slack = _TIMECODE_SLACK if first.is_timecode else _CREATED_SLACK
    return lag - slack, lag + slack
