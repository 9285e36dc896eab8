"""Summary of a capture folder as lines for the panel; read once, not at every redraw, by ``capture_reading``."""

import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import bpy

from .. import addon_state
from ..engine.capture.calibration.camera_files import found_beside
from ..engine.capture.capture import Capture, mask_lines
from ..engine.capture.readers import open_capture
from ..engine.capture.video import find_videos
from ..engine.errors import FrogError
from ..engine.optional_imports import is_missing, not_loaded
from ..tasks.calibration import raw_footage
from ..tasks.clocks import ClockFile, read_clocks


@dataclass(frozen=True)
class CaptureSummary:
    """A capture in a few words.

    Attributes:
        lines, warnings: for the panel.
        error: a sentence when the folder cannot be used; then there is nothing else.
        capture: opened, not decoded.
        raw_footage: what is to be calibrated first, such as "4 videos"; then there are only lines.
        clocks: of the cameras of calibrated videos.
        has_videos: the cameras of the capture can be sought anew.
        found: a calibration that was found beside the one in use; None for none.
    """

    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    error: str = ""
    capture: Capture | None = None
    raw_footage: str = ""
    clocks: ClockFile | None = None
    has_videos: bool = False
    found: Path | None = None

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras, held-out ones first, as previews show the first by default."""
        capture = self.capture
        names = [camera.name for camera in capture.cameras] if capture else []
        return sorted(names, key=lambda name: capture is not None and name not in capture.test_cameras)

    @property
    def previewed(self) -> str:
        """The camera that previews show where none is chosen, and whether it is held out; "" where none is known."""
        name = next(iter(self.cameras), "")
        return f"{name} (held out)" if self.capture is not None and name in self.capture.test_cameras else name


class Inspected(dict[str, tuple[CaptureSummary, object]]):
    """What was found in folders, and their stamps as they were then."""


_CAMERAS = {
    "n3dv": "poses_bounds.npy (N3DV, LLFF)",
    "transforms": "transforms.json (nerfstudio, D-NeRF)",
    "hypernerf": "dataset.json (HyperNeRF, Nerfies)",
    "technicolor": "cameras_parameters.txt (Technicolor)",
    "calibrated_videos": "a calibration of the videos",
    "panoptic_sports": "train_meta.json (PanopticSports)",
    "immersive": "models.json (Immersive Light Field Video)",
    "easyvolcap": "intri.yml and extri.yml (EasyVolcap, EasyMocap)",
    "multipleview": "sparse_ or poses_bounds_multipleview.npy (multipleview)",
    "colmap": "a COLMAP model",
    "calibration_toml": "a TOML file (caliscope, anipose, Pose2Sim)",
}
"""By format, what tells where its cameras stood, and who writes such files."""
_FILES_LOOKED_AT = 100  # of such a folder, at every redraw of the panel


def known(folder: str) -> CaptureSummary | None:
    """The summary of a folder that was inspected, or None. Opens nothing."""
    inspected = addon_state.get(Inspected).get(folder)
    return inspected[0] if inspected else None


def of(settings: Any) -> CaptureSummary:
    """What is known of the capture of ``Scene.frog``; an empty summary where that was not inspected."""
    return known(bpy.path.abspath(settings.capture_folder)) or CaptureSummary()


def is_outdated(folder: str) -> bool:
    """Whether a folder that could not be used as it was has changed, so that what was missing may be there."""
    inspected = addon_state.get(Inspected).get(folder)
    if inspected is None or not (inspected[0].error or inspected[0].raw_footage):
        return False
    return stamp(folder) != inspected[1]


def store(folder: str, summary: CaptureSummary, stamp: object) -> None:
    """Stores the summary of a folder, and its stamp from before it was read."""
    addon_state.get(Inspected)[folder] = summary, stamp


def stamp(folder: str) -> object:
    """Names, times and sizes of a folder's files; None if there is no folder. Hidden ones change as work goes on."""
    try:
        with os.scandir(folder) as entries:
            visible = (entry for entry in entries if not entry.name.startswith("."))
            files = [(entry.name, entry.stat()) for entry in islice(visible, _FILES_LOOKED_AT)]
        return sorted((name, status.st_mtime_ns, status.st_size) for name, status in files)
    except (OSError, ValueError):
        return None


def read(folder: Path, layout: str = "auto") -> CaptureSummary:
    """The summary of a folder, not stored. Any thread may call it; small videos are decoded, which takes a while."""
    try:
        raw = raw_footage(folder)
        if raw:
            sentence = f"Found {raw} without a calibration. Calibrate Cameras finds where the cameras stood."
            return CaptureSummary((sentence,), raw_footage=raw)
        capture = open_capture(folder, layout=layout)
        clocks = read_clocks(folder) if capture.format == "calibrated_videos" else None
        has_videos = bool(find_videos(folder))
        found = found_beside(folder)
    except FrogError as error:
        return CaptureSummary(error=str(error))
    except ImportError as error:
        if not is_missing(error):
            return CaptureSummary(error=f"{not_loaded(error)}.")
        return CaptureSummary(error=f"Reading a capture needs the Python package {error.name or error}.")
    except Exception as error:
        return CaptureSummary(error=f"{folder}: this capture cannot be read ({type(error).__name__}: {error}).")
    return CaptureSummary(_lines(capture), tuple(capture.warnings), "", capture, "", clocks, has_videos, found)


def _lines(capture: Capture) -> tuple[str, ...]:
    sizes = sorted({(camera.width, camera.height) for camera in capture.cameras})
    named = [f"{width} x {height}" for width, height in sizes[:2]]
    size = " and ".join([*named, "others"] if len(sizes) > 2 else named)
    cameras = "one moving camera" if capture.is_moving else f"{len(capture.cameras)} cameras"
    if capture.test_cameras:
        cameras += f", {len(capture.test_cameras)} held out"
    return (
        f"{cameras[0].upper()}{cameras[1:]}",
        f"Camera positions: {_CAMERAS.get(capture.format, capture.format.replace('_', ' '))}",
        f"{capture.frame_count} frames at {capture.frames_per_second:g} per second",
        f"{size} pixels",
        *(f"Masks: {line}" for line in mask_lines(capture)),
    )
