"""Cameras from the joints of a person who moves before them: for views too far apart to share features.

In a standing camera's film the person is what moves, so no detector is needed. A joint lies some 20 pixels off where it
is seen from elsewhere; hundreds of them average that out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s, ImageArray
from ..video import load_opencv
from .calibration import Calibration, CalibrationRefused
from .landmarks import JOINTS, Box, LandmarkNetwork, Person
from .point_rig import PointViews, solve_points
from .rig_result import CameraFacts

_CHANGES = 18  # of 255: what moves at one time
_LEAST_MOTION = 0.01  # of all that ever moves: less is noise, or a person who stands still
_AROUND = 1.25  # of what moves, the box in which the person is sought
_VISIBLE = 0.5
_LIMIT = 0.016  # of the longer side: a joint that is farther off is another one (left for right), or guessed
_USUAL = 0.008  # of the longer side
_LEAST_JOINTS = 120  # of each camera, seen by another at the same time
_LEAST_SHARE = 0.5  # of a camera's joints that must fit
_LONGEST_GAP = 0.25  # seconds between two times across which a joint is interpolated


@dataclass(frozen=True, eq=False)
class Joints:
    """A person's joints in one camera's images.

    Attributes:
        pixels: (T, 16, 2) in the order of landmarks.JOINTS; NaN in an image that shows no person.
        visibility: (T, 16) from 0 to 1.
    """

    pixels: Float64s
    visibility: Float64s

    def at(self, times: Float64s, wanted: Float64s) -> Joints:
        """The joints at other times, linearly between the images of (T,) ascending times; both in seconds."""
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
        gap = times[after] - times[after - 1]
        share = (wanted - times[after - 1]) / gap
        is_known = (share >= -1e-6) & (share <= 1 + 1e-6) & (gap <= _LONGEST_GAP)
        share = np.where(is_known, share, np.nan)[:, None, None]
        pixels = (1 - share) * self.pixels[after - 1] + share * self.pixels[after]
        visibility = np.minimum(self.visibility[after - 1], self.visibility[after])
        return Joints(pixels, np.where(np.isfinite(pixels[:, :, 0]), visibility, 0.0))


def find_joints(
    network: LandmarkNetwork, images: Iterable[ImageArray | None], plate: ImageArray, changing: Bools
) -> Joints:
    """The joints of whoever moves most in a standing camera's images.

    Args:
        network: of the landmark file.
        images: (H, W, 3) RGB or (H, W), in order of time; None where the camera has none.
        plate: (h, w) brightness of the background, of the images' shape, possibly smaller.
        changing: (h, w) where something moves at any time.
    """
    whole = _largest_box(changing, 0)
    pixels, visibility = [], []
    previous: Box | None = None
    for image in images:
        person = None
        if image is not None and whole is not None:
            person = _found(network, image, _boxes(image, plate, changing, whole, previous), previous)
        previous = person.box if person is not None else None
        pixels.append(person.pixels if person is not None else np.full((len(JOINTS), 2), np.nan))
        visibility.append(person.visibility if person is not None else np.zeros(len(JOINTS)))
    return Joints(np.stack(pixels), np.stack(visibility))


def calibrate_joints(facts: Sequence[CameraFacts], groups: Sequence[int], joints: Sequence[Joints]) -> Calibration:
    """The rig that saw a person's joints, at an arbitrary scale.

    Args:
        facts: of the cameras.
        groups: cameras of one number share their focal length.
        joints: of each camera, at the same times.

    Raises:
        CalibrationRefused: if too few joints are shared, do not fit, or leave a focal length open.
    """
    pixels = np.stack([np.where(each.visibility[..., None] > _VISIBLE, each.pixels, np.nan) for each in joints])
    sides = np.array([camera.side for camera in facts])
    views = PointViews(facts, np.array(groups), pixels.reshape(len(facts), -1, 2), _LIMIT * sides)
    seen = views.seen
    for camera, count in zip(facts, (seen & (seen.sum(0) >= 2)).sum(1).tolist(), strict=True):
        if count < _LEAST_JOINTS:
            raise CalibrationRefused(
                f"Camera {camera.name} shares {count} joints of a person with the others, expected {_LEAST_JOINTS} or "
                "more: film one person who walks about where all cameras see them whole, for ten seconds."
            )
    found = solve_points(views, float(_USUAL * sides.max()))
    for camera, share in zip(facts, found.shares.tolist(), strict=True):
        if share < _LEAST_SHARE:
            raise CalibrationRefused(
                f"Only {100 * share:.0f} % of the joints that camera {camera.name} sees fit the other cameras: the "
                "films are not in step, or it sees another person; film one person who walks about alone, or a board."
            )
    return found.calibration


def _found(network: LandmarkNetwork, image: ImageArray, boxes: Iterable[Box], previous: Box | None) -> Person | None:
    """The first box with a person in it, and then that person in a box that fits, as the previous image's does."""
    for box in boxes:
        person = network.find(image, box)
        if person is None:
            continue
        if box is not previous:
            person = network.find(image, person.box) or person
        return network.find_surely(image, person.box)
    return None


def _boxes(image: ImageArray, plate: ImageArray, changing: Bools, whole: Box, previous: Box | None) -> list[Box]:
    """Where to look, in this order, in the image's pixels: where the person was, what moves now, what ever moves."""
    cv2 = load_opencv()
    scale = image.shape[1] / plate.shape[1]
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    small = gray if gray.shape == plate.shape else cv2.resize(gray, plate.shape[::-1], interpolation=cv2.INTER_AREA)
    moving = (cv2.absdiff(small, plate) > _CHANGES) & changing
    now = _largest_box(moving, _LEAST_MOTION * float(changing.sum()))
    found = [box._replace(x=box.x * scale, y=box.y * scale, side=box.side * scale) for box in (now, whole) if box]
    if previous is None:
        return found
    # Unless the person has left it: what moves now must lie in it.
    left = found[0] if now is not None else None
    is_there = left is None or np.hypot(left.x - previous.x, left.y - previous.y) < previous.side / 2
    return [previous, *found] if is_there else found


def _largest_box(moving: Bools, least: float) -> Box | None:
    """The square about the largest connected region; None where it has fewer pixels than ``least``."""
    cv2 = load_opencv()
    opened = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, _, regions, _ = cv2.connectedComponentsWithStats(opened)
    if count < 2:
        return None
    left, top, width, height, area = max(regions[1:].tolist(), key=lambda region: region[4])
    return Box(left + width / 2, top + height / 2, _AROUND * max(width, height)) if area >= least else None
