"""What was found in a capture folder, as lines for the panel; looked at once, not at every redraw."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from .. import addon_state
from ..engine.errors import FrogError
from ..engine.optional_imports import is_missing, not_loaded

if TYPE_CHECKING:
    from ..engine.capture.capture import Capture


@dataclass(frozen=True)
class CaptureSummary:
    """A capture in a few words.

    Attributes:
        lines, warnings: for the panel.
        error: a sentence when the folder cannot be used; then there is nothing else.
        capture: opened, not decoded.
    """

    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    error: str = ""
    capture: Capture | None = None

    @property
    def cameras(self) -> list[str]:
        """Names, those that are held out first: previews show them unless another is chosen."""
        capture = self.capture
        names = [camera.name for camera in capture.cameras] if capture else []
        return sorted(names, key=lambda name: capture is not None and name not in capture.test_cameras)


class Inspected:
    """The folders that were looked into.

    Attributes:
        summaries: what was found, by folder.
        stamps: of the folders, as they were then.
    """

    def __init__(self) -> None:
        self.summaries: dict[str, CaptureSummary] = {}
        self.stamps: dict[str, object] = {}


_FILES_LOOKED_AT = 100  # of such a folder, at every redraw of the panel


def known(folder: str) -> CaptureSummary | None:
    """What ``inspect`` found in a folder, or None if it was not asked yet.  Opens nothing."""
    return addon_state.get(Inspected).summaries.get(folder)


def is_outdated(folder: str) -> bool:
    """Whether a folder that could not be used has changed since, so that the error may be mended."""
    inspected = addon_state.get(Inspected)
    summary = inspected.summaries.get(folder)
    return summary is not None and bool(summary.error) and _stamp(folder) != inspected.stamps.get(folder)


def inspect(folder: str) -> CaptureSummary:
    """Look into a folder and remember what was found."""
    inspected = addon_state.get(Inspected)
    inspected.stamps[folder] = _stamp(folder)
    summary = inspected.summaries[folder] = _inspect(Path(folder)) if folder else CaptureSummary()
    return summary


def _stamp(folder: str) -> object:
    """Changes when files of a folder come, go or are written; nothing for a folder that is not there."""
    try:
        with os.scandir(folder) as entries:
            files = [(entry.name, entry.stat()) for entry in islice(entries, _FILES_LOOKED_AT)]
        return sorted((name, status.st_mtime_ns, status.st_size) for name, status in files)
    except (OSError, ValueError):
        return None


def _inspect(folder: Path) -> CaptureSummary:
    try:
        from ..engine.capture.readers import open_capture

        capture = open_capture(folder)
    except FrogError as error:
        return CaptureSummary(error=str(error))
    except ImportError as error:
        if not is_missing(error):
            return CaptureSummary(error=f"{not_loaded(error)}.")
        return CaptureSummary(error=f"Reading a capture needs the Python package {error.name or error}.")
    except Exception as error:
        return CaptureSummary(error=f"{folder}: this capture cannot be read ({type(error).__name__}: {error}).")
    return CaptureSummary(_lines(capture), tuple(capture.warnings), capture=capture)


def _lines(capture: Capture) -> tuple[str, ...]:
    sizes = sorted({(camera.width, camera.height) for camera in capture.cameras})
    size = " and ".join(f"{width} x {height}" for width, height in sizes[:2]) + (
        " and others" if len(sizes) > 2 else ""
    )
    cameras = "one moving camera" if capture.is_moving else f"{len(capture.cameras)} cameras"
    if capture.test_cameras:
        cameras += f", {len(capture.test_cameras)} held out"
    return (
        f"Format: {capture.format}",
        f"Cameras: {cameras}",
        f"Frames: {capture.frame_count} at {capture.frames_per_second:g} per second",
        f"Size: {size} pixels",
    )
