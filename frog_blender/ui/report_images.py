"""What a calibration found, as images for the panel: the rig from above, and the synchronization curves."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..engine.arrays import ImageArray
from ..engine.capture.calibration.report import REPORT, from_above
from ..engine.capture.capture import Capture
from ..engine.capture.readers.checks import read_json
from ..engine.capture.synchronization.synchronization import draw_curves, read_synchronization
from ..engine.capture.video import load_opencv
from ..engine.errors import FrogError
from ..engine.io.plain_values import UnfitValue
from . import preview_image

ONE_CURVE = "one curve"
"""The name of the curve in ``preview_image`` that is looked at while its clock is corrected."""
_NARROW = 400  # pixels
_SIDE = 480  # pixels
_PAPER, _POINTS, _CAMERA = (255, 255, 255), (170, 170, 170), (30, 100, 200)


def show(folder: Path, capture: Capture | None) -> None:
    """Draws what a folder's calibration found, in place of what an earlier one did.

    Args:
        capture: whose z axis points up, as calibrations write it; None draws nothing.
    """
    try:
        rig = None if capture is None else rig_from_above(capture)
        preview_image.show(rig, rig_name(folder))
        preview_image.show(None if capture is None else curves(folder / REPORT), curves_name(folder))
    except FrogError:  # without OpenCV nothing is drawn
        return


def rig_name(folder: Path) -> str:
    """The name of a folder's rig in ``preview_image``."""
    return f"rig {folder}"


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


def rig_from_above(capture: Capture) -> ImageArray:
    """(SIDE, SIDE, 3) uint8: the cameras with their viewing directions, and the points, seen along -z."""
    cv2 = load_opencv()
    dots, eyes = from_above(capture.cameras, np.empty((0, 3)) if capture.points is None else capture.points, _SIDE)
    image = np.full((_SIDE, _SIDE, 3), _PAPER, np.uint8)
    for dot in dots.round().astype(int).tolist():
        cv2.circle(image, dot, 1, _POINTS, -1)
    for center, ahead in eyes.round().astype(int).tolist():
        cv2.line(image, center, ahead, _CAMERA, 2, cv2.LINE_AA)
        cv2.circle(image, center, 5, _CAMERA, -1, cv2.LINE_AA)
    return image
