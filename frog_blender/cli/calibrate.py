"""``frog calibrate``: a folder of raw films becomes a capture."""

import argparse
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..engine.capture.readers.readings import AUTO, LAYOUTS
from ..engine.errors import UsageError
from . import CANCELLED
from .arguments import Reads, check_there
from .terminal import add_json_argument, complain, say, stopping

_FIGURES = {"focal": "focal_pixels", "residual": "residual_pixels", "offset": "offset_seconds", "rate": "rate"}
"""What ``--json`` calls figures of a camera, by the report's names."""


def add_calibrate_parser(commands: Any) -> None:
    """Adds the command."""
    calibrate = commands.add_parser("calibrate", help="find the cameras of raw videos")
    calibrate.add_argument("folder", type=Path, action=Reads, help="one video of each camera, or of one moving camera")
    calibrate.add_argument("--out", type=Path, metavar="DIR", help="default: beside the videos")
    calibrate.add_argument("--board", type=Path, metavar="FILE|auto", help="find the cameras by a board in the videos")
    clocks = calibrate.add_mutually_exclusive_group()
    clocks.add_argument("--in-step", action="store_true", help="the videos are in step: do not synchronize them")
    clocks.add_argument("--clock", action="append", metavar="CAMERA=SECONDS[,RATE]", help="when a video starts")
    calibrate.add_argument(
        "--use-found", action="store_true", help="use the cameras found beside given ones from now on"
    )
    clocks.add_argument("--background-only", action="store_true", help="use only what does not move")
    layout = calibrate.add_mutually_exclusive_group()
    layout.add_argument("--layout", choices=LAYOUTS, default=AUTO, help="what images and folders of them are of")
    for name, known in (
        ("standing", "all cameras stand, whatever moves before them"),
        ("moving", "one camera moved"),
        ("one-moment", "images that were taken at once, each by a camera of its own"),
    ):
        layout.add_argument(f"--{name}", dest="layout", action="store_const", const=name, help=known)
    add_json_argument(calibrate)
    calibrate.set_defaults(run=_calibrate)


def _calibrate(options: argparse.Namespace) -> int:
    from ..engine.capture.calibration.pipeline import ANY_BOARD, Options, calibrate
    from ..engine.io.child_process import Stopped
    from .progress import whole_bar

    if options.use_found:
        return _use_found(options)
    if options.background_only and options.board is not None:
        raise UsageError("--board with --background-only: found a board that must not move, expected one of the two.")
    check_there({options.board} - {None, ANY_BOARD})
    names = ("out", "in_step", "background_only", "board", "layout")
    chosen = Options(**{name: getattr(options, name) for name in names}, clocks=_clocks(options.clock))
    with stopping() as asked, whole_bar() as told:
        try:
            result = calibrate(options.folder, chosen, told, asked)
        except Stopped:
            complain("cancelled; the same command goes on from here.")
            return CANCELLED
    cameras = json.loads(result.report.read_text(encoding="utf-8")).get("cameras", ())
    options.figures = {
        "calibration": str(result.cameras),
        "is_in_use": not result.given_kept,
        "report": str(result.report),
        "cameras": [{"name": each["name"], **{_FIGURES[key]: each[key] for key in _FIGURES}} for each in cameras],
        "warnings": list(result.warnings),
    }
    for warning in result.warnings:
        say(f"warning: {warning}")
    if result.given_kept:
        say(f"{options.out or options.folder} has a calibration already, which was left as it is and is used.")
        say(f"To use what was found instead: frog calibrate {options.out or options.folder} --use-found")
    say(f"{result.cameras}: the cameras")
    say(f"{result.page}: how they were found")
    return 0


def _use_found(options: argparse.Namespace) -> int:
    """Makes the calibration that was found the one in use."""
    from ..engine.capture.calibration.camera_files import use_found

    used, kept = use_found(options.folder)
    options.figures = {"calibration": str(used), "is_in_use": True}
    say(f"{used}: in use now")
    if kept:
        say(f"{', '.join(str(path) for path in kept)}: what was in use before (renamed back it is in use again)")
    return 0


def _clocks(listed: list[str] | None) -> dict[str, tuple[float, float]] | None:
    """Offset and rate by camera; FrogError for anything that is not of that form."""
    clocks = {}
    for text in listed or ():
        name, _, values = text.rpartition("=")
        offset = rate = 0.0
        with suppress(ValueError):
            offset, rate = (*map(float, values.split(",")), 1.0)[:2]
        if not name or not -1e7 < offset < 1e7 or not 0.5 <= rate <= 2:
            raise UsageError(
                f"--clock {text}: expected CAMERA=SECONDS or CAMERA=SECONDS,RATE with a rate between 0.5 and 2."
            )
        clocks[name] = (offset, rate)
    return clocks or None
