"""The cameras' clocks in ``cameras_opencv.json``: read for the panel, and corrected in a file of our own making."""

import json
from dataclasses import dataclass
from pathlib import Path

from ..engine.capture.readers.calibrated_videos import clock_of
from ..engine.capture.readers.checks import read_json, records
from ..engine.capture.readers.pairing import Clock
from ..engine.errors import FrogError, found_instead
from ..engine.io.atomic_files import write_atomically

CAMERAS = "cameras_opencv.json"
_MAKER = "frog calibrate"


@dataclass(frozen=True)
class ClockFile:
    """The clocks of a capture.

    Attributes:
        path: the calibration that has them.
        clocks: by the cameras' names, in the file's order.
        is_own: this program wrote the file, so that it may change it.
    """

    path: Path
    clocks: dict[str, Clock]
    is_own: bool


def read_clocks(folder: Path) -> ClockFile | None:
    """The clocks of a folder of calibrated videos; None without ``cameras_opencv.json``, or for a single camera.

    Raises:
        FrogError: if the file cannot be used.
    """
    path = folder / CAMERAS
    if not path.is_file():
        return None
    content = read_json(path)
    clocks = {name: clock_of(entry, path, name) for name, entry in _entries(content, path)}
    return ClockFile(path, clocks, content.get("made_by") == _MAKER) if len(clocks) > 1 else None


def write_clock(folder: Path, camera: str, clock: Clock) -> None:
    """Changes one camera's clock, and nothing else, in a calibration that this program wrote.

    Raises:
        FrogError: if the file was given, has no such camera or cannot be written, or a value is out of range.
    """
    path = folder / CAMERAS
    content = read_json(path, keeps_null=True)
    if content.get("made_by") != _MAKER:
        raise FrogError(f"{path}: this calibration was given, so it is not changed; correct it where it was made.")
    named = [entry for name, entry in _entries(content, path) if name == camera]
    if not named:
        raise found_instead(path, f"no camera {camera}", "one of that name")
    named[0].update(offset=clock.offset, rate=clock.rate)
    clock_of(named[0], path, camera)  # what no reader takes is not written
    write_atomically(path, json.dumps(content, indent=1).encode())


def _entries(content: dict[str, object], path: Path) -> list[tuple[str, dict[str, object]]]:
    listed = records(content.get("cameras"), path, "cameras", '"cameras": [{"name": ..., ...}, ...]')
    return [(str(entry.get("name")), entry) for entry in listed]
