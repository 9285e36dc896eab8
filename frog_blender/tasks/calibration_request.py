"""Calibration requests: which folder, and the engine's pipeline for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..engine.capture.calibration.pipeline import Outcome

Progress = Callable[[str, int, int], None]
"""Is told a stage's name, and how much of how much is done."""
Calibrator = Callable[[Progress, Callable[[], bool]], "Outcome"]
"""Calibrates; is given where to report progress, and what to ask whether to stop. Called on the worker thread."""


@dataclass(frozen=True)
class CalibrationRequest:
    """What to calibrate.

    Attributes:
        folder: with a video of each camera, or one moving camera's.
        points: a file of clicked points, if the cameras are to come from them alone.
    """

    folder: Path
    points: Path | None = None

    def calibrate(self, progress: Progress, cancelled: Callable[[], bool]) -> Outcome:
        """Runs the pipeline, whose heavy parts run in processes of their own."""
        from ..engine.capture.calibration.pipeline import Options, calibrate

        return calibrate(self.folder, Options(points=self.points), progress, cancelled)


def raw_footage(folder: Path) -> str:
    """What a folder holds that is to be calibrated first, such as "4 videos"; "" for a capture, and without any.

    Decodes nothing.
    """
    from ..engine.capture.calibration.moving import still_images
    from ..engine.capture.calibration.result_files import is_calibrated
    from ..engine.capture.video import find_videos

    try:
        if not folder.is_dir() or is_calibrated(folder):
            return ""
        videos = find_videos(folder)
        if videos:
            return f"{len(videos)} videos" if len(videos) > 1 else "1 video"
        images = still_images(folder)
    except OSError:
        return ""
    return f"{len(images)} images of a moving camera" if images else ""
