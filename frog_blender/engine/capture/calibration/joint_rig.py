"""Cameras from the joints of a person who walks about before them: for views too far apart to share features.

A joint lies some 20 pixels off where it is seen from elsewhere; hundreds of them average that out. Clocks come from
elsewhere: they are given, or heard. Joints of films that are out of step by a few frames fit other cameras as well, and
how much moves when is seen unlike from far apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from ...arrays import Float64s, Ints
from ..epipolar import fundamental
from ..synchronization.films import CalibrationRefused, Film, Run
from . import limits
from .checks import calibration_of
from .colmap import Adjusted, adjust, verified
from .joints import JOINTS, LandmarkNetwork, agreed_sides, find_joints, with_sides
from .model import Calibration, Lens, Model, Tracks, disagreement, tracks_of
from .structure import Images, propose
from .views import ALMOST, CameraFacts, common_times, images_at, views_of

_TIMES = 40  # common ones at which joints are looked for: 30 are enough; each costs a quarter of a second a camera
REMEDY = "film one person who walks about alone for ten seconds or more, near and far, where all cameras see them whole"
_LEAST_PAIR = 8  # joints that two cameras share, before they are asked how they stand
_MANY = 60  # joints of a pair, of which some may be false
_SIDE_ROUNDS = 2  # of asking the other cameras which side is left


def calibrate_joint_films(run: Run, network: Path, films: Sequence[Film], _count: int = 0) -> Calibration:
    """The cameras of films in which one person walks about, from their joints at common times.

    Args:
        network: the landmark file (``landmark_file``).

    Raises:
        CalibrationRefused: see ``calibrate_joints``.
        FrogError: for a film that cannot be decoded, or another file than the network's.
    """
    views, times = views_of(run, films, alike=ALMOST), common_times(films, _TIMES)
    loaded = LandmarkNetwork(network)
    joints = []
    for index, (film, file) in enumerate(zip(films, views, strict=True)):
        run.progress("joints", index, len(films))
        view = file.view(run.work)
        joints.append(find_joints(loaded, images_at(film, times, run.check), view.background, view.changing))
    return run.in_child(calibrate_joints, views, np.stack(joints))


def calibrate_joints(facts: Sequence[CameraFacts], pixels: Float64s) -> Calibration:
    """The rig that saw a person's joints, at an arbitrary scale; a warning where two halves of the times disagree.

    Args:
        facts: of the cameras.
        pixels: (C, T, 16, 2) joints at the same times; NaN where none is surely seen.

    Raises:
        CalibrationRefused: if too few joints are shared, do not fit, or leave a focal length open, or if two halves of
            the times disagree by a lot.
    """
    rig = _rig_of(facts, pixels)
    calibration = calibration_of([camera.name for camera in facts], rig)
    for camera, calibrated in zip(facts, calibration.cameras, strict=True):
        share = calibrated.support.share
        if share < limits.JOINTS_AGREEING:
            raise CalibrationRefused(
                f"Only {100 * share:.0f} % of the joints that camera {camera.name} sees fit the other cameras: the "
                f"films are not in step, or it sees another person; {REMEDY}."
            )

    is_early = 2 * (rig.tracks.features // len(JOINTS)) < pixels.shape[1]
    groups, straight = [camera.group for camera in facts], [0] * len(facts)
    parts = (rig.tracks.chosen(part) for part in (is_early, ~is_early))
    one, other = (adjust(rig.model, part, groups, straight).model for part in parts)
    apart = disagreement(one, other)
    calibration = replace(calibration, halves_apart=apart)
    if len(facts) == 2:
        warning = "Nothing but each other tests two cameras' positions: look at the result."
    elif apart > limits.JOINTS_APART:
        raise CalibrationRefused(
            f"The film's two halves put the cameras {100 * apart:.0f} % of the rig's size apart: "
            f"{REMEDY}, or hold a board into the views."
        )
    elif apart > limits.DOUBTFUL_JOINTS_APART:
        warning = f"Camera positions are known within about {100 * apart:.1f} % of the rig's size only."
    else:
        return calibration
    return replace(calibration, warnings=(*calibration.warnings, warning))


def _rig_of(facts: Sequence[CameraFacts], pixels: Float64s) -> Adjusted:
    """The rig before it is judged, with left for right where the cameras agree about that."""
    pixels = np.where(np.isfinite(pixels[..., :1]).sum(0) < 2, np.nan, pixels)  # of no use, and no fault
    for camera, count in zip(facts, np.isfinite(pixels[..., 0]).sum((1, 2)).tolist(), strict=True):
        if count < limits.JOINTS:
            raise CalibrationRefused(
                f"Camera {camera.name} shares {count} joints of a person with the others, expected {limits.JOINTS} or "
                f"more: {REMEDY}."
            )
    start = None
    for _ in range(1 + _SIDE_ROUNDS):
        rig = _solved(facts, pixels.reshape(len(facts), -1, 2), start)
        cameras = [lens.camera("", pose) for lens, pose in zip(rig.model.lenses, rig.model.poses, strict=True)]
        pairs = combinations(range(len(cameras)), 2)
        matrices = {(one, other): fundamental(cameras[one], cameras[other]) for one, other in pairs}
        swapped = agreed_sides(pixels, matrices, limits.JOINT_FALSE * max(camera.side for camera in facts))
        if not swapped.any():
            break
        pixels, start = with_sides(pixels, swapped), rig.model
    return rig


def _solved(facts: Sequence[CameraFacts], pixels: Float64s, start: Model | None) -> Adjusted:
    """The rig that (C, P, 2) joints fit, from a model near the answer if there is one."""
    lenses = tuple(
        Lens(*camera.size, 1.2 * camera.side, tolerance=limits.JOINT_FALSE * camera.side / camera.width)
        for camera in facts
    )
    images = Images(lenses, tuple(camera.group for camera in facts), tuple(np.nan_to_num(pixels)), 0)
    seen = np.isfinite(pixels[:, :, 0])
    shared = {pair: np.flatnonzero(seen[list(pair)].all(axis=0)) for pair in combinations(range(len(facts)), 2)}
    pairs = {pair: np.stack([points, points], axis=1) for pair, points in shared.items()}
    tracks = tracks_of(pairs, images.pixels)
    if start is not None:
        adjusted = adjust(start, tracks, images.groups, [0] * len(facts))
    elif (found := _found(images, pairs, tracks)) is not None:
        adjusted = found
    else:
        fewest = sorted(shared.items(), key=lambda pair: len(pair[1]))[:6]
        poor = ", ".join(f"{facts[one].name} and {facts[other].name} ({len(own)})" for (one, other), own in fewest)
        raise CalibrationRefused(
            f"The joints do not join all cameras to one rig, the fewest are shared by {poor}: {REMEDY}."
        )
    worst = int(np.argmax(adjusted.uncertainty))
    if not adjusted.uncertainty[worst] < limits.MOST_UNSURE:
        raise CalibrationRefused(
            f"The focal length of camera {facts[worst].name} stays uncertain by "
            f"{100 * adjusted.uncertainty[worst]:.0f} %: {REMEDY}."
        )
    return adjusted


def _found(images: Images, pairs: Mapping[tuple[int, int], Ints], tracks: Tracks) -> Adjusted | None:
    """The best of all starts; None where none joins all cameras."""
    enough = {pair: points for pair, points in pairs.items() if len(points) >= _LEAST_PAIR}
    for (one, other), points in enough.items():
        if len(points) >= _MANY:  # a camera may have seen another person
            first, second = ((images.lenses[index], images.pixels[index]) for index in (one, other))
            enough[one, other] = verified(*first, *second, points)
    best = propose(images, tracks, enough, lambda *_: None).get(False)
    return best if best is not None and len(best.model.placed) == len(images.lenses) else None
