"""Projects of programs that calibrate cameras: a calibration, and one or several recordings of the same rig.

Opened is a project of one recording, or a recording: its own folder (``recordings/walk``), that of its films, or a path
that names it among others (see ``footage``). Its calibration is that of the project above.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path

from ...errors import FrogError, found_instead
from .filmed import filmed_by
from .footage import Footage, find_footage, images_in, is_of, several_recordings
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


def the_calibration(path: Path, pattern: str, names_in: Callable[[Path], Sequence[str]]) -> Path:
    """The likeliest of ``calibrations``; FrogError where others in or below its folder differ and name cameras that
    filmed."""
    files = calibrations(path, pattern, names_in)
    first = next(files)
    fit: dict[bytes, Path] = {}
    for file in (first, *takewhile(lambda file: file.is_relative_to(first.parent), files)):
        names = names_in(file)
        if filmed_by(path, names, recorded(path, names))[0]:
            fit.setdefault(file.read_bytes(), file)
    if len(fit) > 1:
        found = f"{len(fit)} calibrations that differ ({', '.join(file.name for file in fit.values())})"
        raise found_instead(first.parent, found, "one: move the others away")
    return next(iter(fit.values()), first)


def recorded(path: Path, names: Sequence[str]) -> list[Footage]:
    """What the cameras of these names filmed in a project, or in one of its recordings; other footage where none has
    their names.

    Raises:
        FrogError: for several recordings in folders of their own.
    """
    if not path.is_dir():
        there = find_footage(path.parent)
        recordings, _ = filmed_by(path, names, there)
        taken = [film for filmed in recordings.values() for film in filmed.values()]
        filmed = recordings.get(path, {}).values()
        return [*filmed, *(film for film in there if film not in taken and is_of(path, film))] if filmed else []
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
        if not footage and (found := images_in(path / place)):  # of several cameras
            footage = [Footage("images", found.files, found.numbers, found.strays)]
        shown = {of_camera.name for of_camera in footage}
        are_cameras = several or len(shown) == len(footage) or len(shown.intersection(names)) > 1
        if are_cameras and filmed_by(path, names, footage)[0]:
            return footage
    return []
