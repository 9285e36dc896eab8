"""What a synchronization found, as images for the panel: its curves."""

from dataclasses import replace
from pathlib import Path

from ..engine.arrays import ImageArray
from ..engine.capture.calibration.report import REPORT
from ..engine.capture.readers.checks import read_json
from ..engine.capture.synchronization.synchronization import draw_curves, read_synchronization
from ..engine.errors import FrogError
from ..engine.io.plain_values import UnfitValue
from . import preview_image

ONE_CURVE = "one curve"
"""The name of the curve in ``preview_image`` that is looked at while its clock is corrected."""
_NARROW = 400  # pixels


def show(folder: Path, is_known: bool) -> None:
    """Draws the curves of a folder's calibration in place of those of an earlier one; none where nothing is known of
    the capture.
    """
    try:
        preview_image.show(curves(folder / REPORT) if is_known else None, curves_name(folder))
    except FrogError:  # without OpenCV nothing is drawn
        return


def curves_name(folder: Path) -> str:
    """The name of a folder's synchronization curves in ``preview_image``."""
    return f"curves {folder}"


def show_curve(folder: Path, camera: str) -> None:
    """Draws one camera's curve as ``ONE_CURVE``, large enough to be read."""
    try:
        preview_image.show(curves(folder / REPORT, camera), ONE_CURVE)
    except FrogError:  # without OpenCV nothing is drawn
        preview_image.show(None, ONE_CURVE)


def curves(report: Path, camera: str = "") -> ImageArray | None:
    """(H, W, 3) uint8, the curves in a report, or one camera's; None for a report without any, or none that can be
    read.
    """
    if not report.is_file():
        return None
    try:
        stored = read_json(report, keeps_null=True).get("synchronization")
        synchronization = None if stored is None else read_synchronization(stored)
    except (FrogError, UnfitValue):
        return None
    if synchronization is None or not camera:
        return None if synchronization is None else draw_curves(synchronization)
    chosen = tuple(clock for clock in synchronization.cameras if clock.name == camera)
    return draw_curves(replace(synchronization, cameras=chosen), _NARROW) if chosen else None
