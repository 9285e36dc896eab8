"""Projects of programs that calibrate cameras: a calibration, and one or several recordings of the same rig.

Opened is a project of one recording, or a recording: its own folder (``recordings/walk``), that of its films, or a path
that names it among others (see ``footage``). Its calibration is that of the project above.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ...errors import FrogError
from .footage import Footage, filmed_by, find_footage, images_in, several_recordings
from .readings import AUTO, chosen_layout

_CALIBRATIONS = ("calibration", "Calibration", "calibration-videos", "calib", "optimized")
_BELOW = (".", *_CALIBRATIONS, "calibration/extrinsic", "calibration/extrinsic/capture_volume")
_FOOTAGE = (".", "images", "videos", "synchronized_videos", "videos-raw", "frames")
_RECORDINGS = ("recordings", "videos", "videos-raw", ".")
_NO_RECORDINGS = {*_CALIBRATIONS, *_FOOTAGE, *_RECORDINGS}
_ABOVE = 3  # folders above a recording in which a calibration is looked for
_NAMES = ("camera_array.toml", "calibration.toml", "calib.toml")
_MOST_FILES = 20  # of a folder
_MOST = 200  # folders in which recordings are looked for


def calibrations(path: Path, pattern: str, names_in: Callable[[Path], Sequence[str]]) -> Iterator[Path]:
    """The calibrations of a project, files that name cameras, the likeliest first; above a recording, those whose
    cameras' names its footage has. In the project itself one that cannot be read will do, if it is named as a
    calibration.

    Args:
        pattern: of the file's name.
        names_in: the names of a file's cameras; FrogError for one that cannot be read.
    """
    damaged = None
    for project in (path, *path.absolute().parents[:_ABOVE]):
        folders = [project / below for below in _BELOW if os.path.isdir(project / below)]  # False where it is locked
        for file in (file for folder in folders for file in sorted(folder.glob(pattern))[:_MOST_FILES]):
            try:
                names = names_in(file)
                with chosen_layout(AUTO):  # whose calibration it is does not depend on what the user says of names
                    is_own = names and (project == path or filmed_by(path, names, recorded(path, names))[0])
                if is_own:
                    yield file
            except FrogError:
                is_named = project == path and (file.suffix != ".toml" or file.name.lower() in _NAMES)
                damaged = damaged or (file if is_named else None)
        if damaged:
            yield damaged


def recorded(path: Path, names: Sequence[str]) -> list[Footage]:
    """What the cameras of these names filmed in a project, or in one of its recordings; other footage where none has
    their names.

    Raises:
        FrogError: for several recordings in folders of their own.
    """
    if not path.is_dir():
        return list(filmed_by(path, names, find_footage(path.parent))[0].get(path, {}).values())
    if footage := _filmed(path, names):
        return footage
    places = [path / place for place in _RECORDINGS if (path / place).is_dir()]
    folders = [folder for place in places for folder in sorted(place.iterdir()) if folder.is_dir()]
    looked = [folder for folder in folders if folder.name not in _NO_RECORDINGS and not folder.name.startswith(".")]
    below = {folder: footage for folder in looked[:_MOST] if (footage := _filmed(folder, names))}
    if len(below) > 1:
        raise several_recordings(path, list(below))
    others = next(filter(None, map(find_footage, places)), [])
    return next(iter(below.values()), []) or _filmed(path, names, several=True) or others


def _filmed(path: Path, names: Sequence[str], *, several: bool = False) -> list[Footage]:
    """The footage of a recording's folder, in the first of the usual places in which some has the cameras' names.

    Args:
        several: folders of several films may be cameras; else they are recordings, unless named as cameras.
    """
    for place in _FOOTAGE:
        footage = find_footage(path / place) if (path / place).is_dir() else []
        footage = footage or list(filter(None, [images_in(path / place)]))  # of several cameras
        shown = {of_camera.name for of_camera in footage}
        are_cameras = several or len(shown) == len(footage) or len(shown.intersection(names)) > 1
        if are_cameras and filmed_by(path, names, footage)[0]:
            return footage
    return []
