"""Cameras from the joints of a person who moves before them: for views too far apart to share features.

In a standing camera's film the person is what moves, so no detector is needed. A joint lies some 20 pixels off where it
is seen from elsewhere; hundreds of them average that out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...arrays import Bools, Float64s, ImageArray
from ..synchronization.epipolar import fundamental
from ..video import load_opencv
from .calibration import Calibration, CalibrationRefused
from .joint_sides import agreed_sides, other_side
from .landmarks import JOINTS, Box, LandmarkNetwork, Person
from .point_rig import PointRig, PointViews, solve_points
from .rig_result import CameraFacts
from .rig_solver import Rig

_CHANGES = 18  # of 255: what moves at one time
_LEAST_MOTION = 0.01  # of all that ever moves: less is noise, or a person who stands still
_AROUND = 1.25  # of what moves, the box in which the person is sought
VISIBLE = 0.5
"""A joint of a smaller visibility is a guess."""
REMEDY = "film one person who walks about alone for ten seconds or more, near and far, where all cameras see them whole"
_LIMIT = 0.016  # of the longer side: a joint that is farther off is another one (left for right), or guessed
_USUAL = 0.008  # of the longer side
_LEAST_JOINTS = 120  # of each camera, seen by another at the same time
_APART, _DOUBTFUL_APART = 0.05, 0.01  # of the rig's diameter: where two halves of the times put a camera
_LEAST_SHARE = 0.5  # of a camera's joints that must fit
_SIDE_ROUNDS = 2  # of asking the other cameras which side is left
_BESIDE = 2  # images before and after
_STRAY = 0.06  # of the height of what is seen of the person
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

    @property
    def visible(self) -> Float64s:
        """(T, 16, 2) pixels, NaN for joints that are not surely seen."""
        return np.where(self.visibility[..., None] > VISIBLE, self.pixels, np.nan)

    def with_sides(self, swapped: Bools) -> Joints:
        """The same with left for right in some images (T,)."""
        order = np.where(swapped[:, None], other_side(len(JOINTS)), np.arange(len(JOINTS)))
        pixels = np.take_along_axis(self.pixels, order[..., None], axis=1)
        return Joints(pixels, np.take_along_axis(self.visibility, order, axis=1))

    def at(self, times: Float64s, wanted: Float64s) -> Joints:
        """The joints at other times, by cubics through the images of (T,) ascending times; both in seconds."""
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
        gap = times[after] - times[after - 1]
        share = (wanted - times[after - 1]) / gap
        is_known = (share >= -1e-6) & (share <= 1 + 1e-6) & (gap <= _LONGEST_GAP)
        share = np.where(is_known, share, np.nan)[:, None, None]
        slopes = self._slopes(times)
        before, behind, gap = self.pixels[after - 1], self.pixels[after], gap[:, None, None]
        # Hermite's cubic; a straight line where a neighbour is missing.
        straight = behind - before
        start = np.where(np.isfinite(slopes[after - 1]), slopes[after - 1] * gap, straight)
        end = np.where(np.isfinite(slopes[after]), slopes[after] * gap, straight)
        bent = share * (1 - share) * ((1 - share) * (start - straight) - share * (end - straight))
        pixels = before + share * straight + bent
        visibility = np.minimum(self.visibility[after - 1], self.visibility[after])
        return Joints(pixels, np.where(np.isfinite(pixels[:, :, 0]), visibility, 0.0))

    def _slopes(self, times: Float64s) -> Float64s:
        """(T, 16, 2) pixels a second, from the images before and after; NaN at the ends, and across long gaps."""
        slopes = np.full(self.pixels.shape, np.nan)
        if len(times) > 2:
            lasted = times[2:] - times[:-2]
            lasted = np.where(lasted <= 2 * _LONGEST_GAP, lasted, np.nan)
            slopes[1:-1] = (self.pixels[2:] - self.pixels[:-2]) / lasted[:, None, None]
        return slopes


def without_strays(joints: Joints) -> Joints:
    """The joints of images in order of time, without those that lie off their way through five of them."""
    visible = joints.visible
    padded = np.pad(visible, ((_BESIDE, _BESIDE), (0, 0), (0, 0)), constant_values=np.nan)
    around = np.stack([padded[shift : shift + len(visible)] for shift in range(2 * _BESIDE + 1)])
    rows = visible[np.isfinite(visible[:, :, 0]).any(1), :, 1]
    if not len(rows):
        return joints
    size = float(np.median(np.nanmax(rows, axis=1) - np.nanmin(rows, axis=1)))
    counts = np.isfinite(around).sum(0)
    ordered = np.sort(around, axis=0)  # what is not seen comes last
    middle = np.take_along_axis(ordered, np.maximum(counts - 1, 0)[None] // 2, axis=0)[0]
    is_stray = np.linalg.norm(visible - middle, axis=2) > _STRAY * size
    return Joints(joints.pixels, np.where(is_stray, 0.0, joints.visibility))


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
    return judged(facts, rig_of(facts, groups, joints))


def rig_of(
    facts: Sequence[CameraFacts],
    groups: Sequence[int],
    joints: Sequence[Joints],
    moving: Float64s | None = None,
    *,
    start: Rig | None = None,
    halves: bool = True,
) -> PointRig:
    """The rig before it is judged.

    Args:
        moving: (C, T, 16, 2) pixels a second by which the joints move, where the cameras' clocks are to be corrected.
        start: a rig near the answer, if one is known.
        halves: two halves of the times are compared.

    Raises:
        CalibrationRefused: if too few joints are shared, or they join no rig.
    """
    pixels = np.stack([each.visible for each in joints])
    pixels[:, np.isfinite(pixels[..., 0]).sum(0) < 2] = np.nan  # of no use, and no fault
    sides = np.array([camera.side for camera in facts])
    views = PointViews(facts, np.array(groups), pixels.reshape(len(facts), -1, 2), _LIMIT * sides, REMEDY)
    seen = views.seen
    for camera, count in zip(facts, seen.sum(1).tolist(), strict=True):
        if count < _LEAST_JOINTS:
            raise CalibrationRefused(
                f"Camera {camera.name} shares {count} joints of a person with the others, expected {_LEAST_JOINTS} or "
                f"more: {REMEDY}."
            )
    loss = float(_USUAL * sides.max())
    times = np.repeat(np.arange(pixels.shape[1]), len(JOINTS))
    early = 2 * times < pixels.shape[1] if halves else None

    def solved(start: Rig | None) -> PointRig:
        velocities = None if moving is None else moving.reshape(len(facts), -1, 2)
        given = replace(views, pixels=pixels.reshape(len(facts), -1, 2), velocities=velocities)
        return solve_points(given, loss, halves=early, start=start)

    found = solved(start)
    for _ in range(_SIDE_ROUNDS):
        swapped = agreed_sides(pixels, _matrices(found.calibration), float(_LIMIT * sides.max()))
        if not swapped.any():
            break
        pixels = _with_sides(pixels, swapped)
        moving = None if moving is None else _with_sides(moving, swapped)
        found = solved(found.rig)
    return found


def _with_sides(joints: Float64s, swapped: Bools) -> Float64s:
    """Joints (C, T, 16, ...) with left for right in some images (C, T)."""
    return np.where(swapped[:, :, None, None], joints[:, :, other_side(len(JOINTS))], joints)


def _matrices(found: Calibration) -> dict[tuple[int, int], Float64s]:
    cameras = [each.camera for each in found.cameras]
    return {
        (one, other): fundamental(cameras[one], cameras[other]) for one, other in combinations(range(len(cameras)), 2)
    }


def judged(facts: Sequence[CameraFacts], found: PointRig) -> Calibration:
    """A rig's calibration, with its doubts as warnings.

    Raises:
        CalibrationRefused: if too few joints fit a camera, or two halves of the times disagree.
    """
    for camera, share in zip(facts, found.shares.tolist(), strict=True):
        if share < _LEAST_SHARE:
            raise CalibrationRefused(
                f"Only {100 * share:.0f} % of the joints that camera {camera.name} sees fit the other cameras: the "
                f"films are not in step, or it sees another person; {REMEDY}."
            )
    return _judged(found.calibration)


def _judged(found: Calibration) -> Calibration:
    """The calibration with a warning where two halves of the times disagree a little, refused where they do a lot."""
    apart = found.halves_apart
    if len(found.cameras) > 2 and apart > _APART:
        raise CalibrationRefused(
            f"The film's two halves put the cameras {100 * apart:.0f} % of the rig's size apart: "
            f"{REMEDY}, or hold a board into the views."
        )
    if len(found.cameras) > 2 and apart > _DOUBTFUL_APART:
        warning = f"Camera positions are known within about {100 * apart:.1f} % of the rig's size only."
    elif len(found.cameras) == 2:
        warning = "Nothing but each other tests two cameras' positions: look at the result."
    else:
        return found
    return replace(found, warnings=(*found.warnings, warning))


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
