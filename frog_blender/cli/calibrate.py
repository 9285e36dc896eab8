"""``frog calibrate``: a folder of raw films becomes a capture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..engine.errors import FrogError
from .printing import complain, say
from .stopping import stopping


def add_calibrate_parser(commands: Any) -> None:
    """Adds the command."""
    calibrate = commands.add_parser("calibrate", help="find the cameras of raw videos")
    calibrate.add_argument("folder", type=Path, help="one video of each camera, or of one moving camera")
    calibrate.add_argument("--out", type=Path, metavar="DIR", help="default: beside the videos")
    clocks = calibrate.add_mutually_exclusive_group()
    clocks.add_argument("--in-step", action="store_true", help="the videos are in step: do not synchronise them")
    clocks.add_argument("--clock", action="append", metavar="CAMERA=SECONDS[,RATE]", help="when a video starts")
    clocks.add_argument("--background-only", action="store_true", help="use only what does not move")
    calibrate.set_defaults(run=_calibrate)


def _calibrate(options: argparse.Namespace) -> int:
    from ..engine.capture.calibration.child_process import CalibrationCancelled
    from ..engine.capture.calibration.pipeline import Options, calibrate
    from .progress import stage_bars

    chosen = Options(options.out, options.in_step, options.background_only, _clocks(options.clock))
    with stopping() as asked, stage_bars() as progress:
        try:
            found = calibrate(options.folder, chosen, progress, asked)
        except CalibrationCancelled:
            complain("cancelled; the same command goes on from here.")
            return 1
    for warning in found.warnings:
        say(f"warning: {warning}")
    if found.given_kept:
        say(f"{options.out or options.folder} has a calibration already, which was left as it is.")
    say(f"{found.cameras}: the cameras")
    say(f"{found.page}: how they were found")
    return 0


def _clocks(listed: list[str] | None) -> dict[str, tuple[float, float]] | None:
    """Offset and rate by camera; FrogError for anything that is not of that form."""
    if listed is None:
        return None
    clocks = {}
    for text in listed:
        name, _, values = text.rpartition("=")
        try:
            offset, rate = (*map(float, values.split(",")), 1.0)[:2]
        except ValueError as error:
            raise FrogError(f"--clock {text}: expected CAMERA=SECONDS or CAMERA=SECONDS,RATE.") from error
        if not name or not -1e7 < offset < 1e7 or not 0.5 <= rate <= 2:
            raise FrogError(f"--clock {text}: expected a camera, seconds, and a rate between 0.5 and 2.")
        clocks[name] = (offset, rate)
    return clocks
