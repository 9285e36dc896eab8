"""Whether a video program shows the files of a capture as training saw them, lens distortion aside."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..capture.movie_header import read_movie_header
from ..capture.orientation import UPRIGHT, orientation_in_header
from ..capture.tone_mapping import transfer_of
from ..capture.video import VIDEO_SUFFIXES

if TYPE_CHECKING:
    from ..capture.capture import Capture

_ROUNDING = 0.001  # seconds by which stamps may waver


def is_shown_as_filmed(capture: Capture) -> bool:
    """False where a film's images do not follow the capture's frames one by one, or are tone-mapped, or where images
    are turned by their EXIF, which not every program obeys."""
    films = {shot.path for shot in capture.shots if _is_video(shot.path)}
    if any(shot.path in films and shot.index != shot.frame for shot in capture.shots):
        return False
    if any(transfer_of(film, read_movie_header(film)) for film in films):
        return False
    return all(_is_upright(image) for image in {shot.path for shot in capture.shots} - films)


def are_plain_films(films: Iterable[Path]) -> bool:
    """True for films of one constant rate that start together and are of ordinary range, as their headers say; False
    where these do not say it. Images are none."""
    starts = []
    for film in films:
        if not _is_video(film):
            continue
        header = read_movie_header(film)
        if header is None or header.timestamps is None or transfer_of(film, header):
            return False
        if len(header.timestamps) > 2 and np.ptp(np.diff(header.timestamps)) > _ROUNDING:
            return False
        starts.append(header.timestamps[0])
    return not starts or float(np.ptp(starts)) <= _ROUNDING


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES


def _is_upright(image: Path) -> bool:
    with image.open("rb") as file:
        return orientation_in_header(file) == UPRIGHT
