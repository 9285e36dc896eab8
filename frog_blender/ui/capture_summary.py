"""What was found in a capture folder, as lines for the panel; looked at once, not at every redraw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..engine.errors import FrogError


@dataclass(frozen=True)
class CaptureSummary:
    """A capture in a few words; ``error`` is a sentence and the rest empty when the folder cannot be used."""

    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    error: str = ""


_known: dict[str, CaptureSummary] = {}


def known(folder: str) -> CaptureSummary | None:
    """What ``inspect`` found in a folder, or None if it was not asked yet.  Reads nothing."""
    return _known.get(folder)


def inspect(folder: str) -> CaptureSummary:
    """Look into a folder and remember what was found."""
    summary = _inspect(Path(folder)) if folder else CaptureSummary()
    _known[folder] = summary
    return summary


def _inspect(folder: Path) -> CaptureSummary:
    try:
        from ..engine.capture.readers import open_capture

        capture = open_capture(folder)
    except FrogError as error:
        return CaptureSummary(error=str(error))
    except ImportError as error:
        return CaptureSummary(error=f"Reading a capture needs the Python package {error.name or error}.")
    except Exception as error:
        return CaptureSummary(error=f"{folder}: this capture cannot be read ({type(error).__name__}: {error}).")
    sizes = sorted({(camera.width, camera.height) for camera in capture.cameras})
    size = " and ".join(f"{width} x {height}" for width, height in sizes[:2]) + (
        " and others" if len(sizes) > 2 else ""
    )
    cameras = "one moving camera" if capture.is_moving else f"{len(capture.cameras)} cameras"
    if capture.test_cameras:
        cameras += f", {len(capture.test_cameras)} held out"
    lines = (
        f"Format: {capture.format}",
        f"Cameras: {cameras}",
        f"Frames: {capture.frame_count} at {capture.frames_per_second:g} per second",
        f"Size: {size} pixels",
    )
    return CaptureSummary(lines, tuple(capture.warnings))
