"""Cameras from the joints of a person who walks about before them: for views too far apart to share features.

A joint lies some 20 pixels off where it is seen from elsewhere; hundreds of them average that out. Clocks come from
elsewhere: they are given, or heard. Only films without sound are timed by the joints themselves, whose tracks the
synchronisation compares; a bundle adjustment whose unknowns include the clocks decides between the offsets that it
leaves open, and refines them to a part of a frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...arrays import Float64s
from ..epipolar import fundamental
from ..synchronization import NamedTracks
from .board import images_at
from .calibration import Calibration, CalibrationRefused
from .clocks import FoundClocks, with_clocks
from .films import Film, View, common_times
from .joints import (
    agreed_sides,
    find_joints,
    heights,
    leaves_sides_open,
    steady_sides,
    with_sides,
    without_strays,
)
from .landmarks import JOINTS, LandmarkNetwork
from .model import Model
from .placing import Run, place_by_joints, place_by_tracks
from .points import CameraFacts, PointRig, PointViews, solve_points

TIMES = 40
"""Common times at which joints are looked for: 30 are enough, and each costs a quarter of a second a camera."""
REMEDY = "film one person who walks about alone for ten seconds or more, near and far, where all cameras see them whole"
_LIMIT = 0.016  # of the longer side: a joint that is farther off is another one (left for right), or guessed
_LEAST_JOINTS = 120  # of each camera, seen by another at the same time
_APART, _DOUBTFUL_APART = 0.05, 0.01  # of the rig's diameter: where two halves of the times put a camera
_LEAST_SHARE = 0.5  # of a camera's joints that must fit
_SIDE_ROUNDS = 2  # of asking the other cameras which side is left
# Clocks from joints alone.
_MOST_IMAGES = 80  # of each film
_INTERVALS = (1 / 30, 0.1)  # seconds between them: a walking person's joints are known between them
_LONGEST_GAP = 0.25  # seconds between two images across which a joint is interpolated
_LEAST_IMAGES, _LEAST_MOVING = 10, 6  # of a joint, and joints that must move: else noise is taken for motion
_LEAST_RANGE = 0.02  # of the person's height, how far a joint that moves goes, as a median
_MOST_STARTS = 4
_ROUNDS = 5  # of reading joints at corrected times
_SETTLED = 0.02  # of the interval
_FIRST_TIMES = 30  # at which joints are compared in the first round
_AS_GOOD = 1.1  # times the least cost, which another answer may have: chance does as much
_AS_LONG = 0.9  # of the longest time that answers as good explain: less is easier to fit
_CORRELATED = 4.0  # times the standard deviation: joints of successive images err together
_LEAST_SHIFT = 0.2  # frames by which films in step may differ
_UNSURE = 0.5  # frames of standard deviation of an offset

Find = Callable[[Sequence[Film], Mapping[str, NamedTracks]], FoundClocks]
"""The films' clocks by sound, else by points known by name."""


def calibrate_joint_films(
    films: Sequence[Film],
    views: Sequence[View],
    times: Sequence[float],
    network: Path,
    run: Run,
) -> Calibration:
    """The cameras of films in which one person walks about, from their joints at common capture times in seconds.

    Args:
        views: of the films, for their backgrounds and what moves before them.
        network: the landmark file (``landmark_file``).

    Raises:
        CalibrationRefused: see ``calibrate_joints``.
        FrogError: for a film that cannot be decoded, or another file than the network's.
    """
    joints = _joints_of_films(films, views, [times] * len(films), network, run)
    facts = [CameraFacts(film.name, *film.size) for film in films]
    return place_by_joints(facts, [view.group for view in views], np.stack(joints), run)


def calibrate_unsynchronised_films(
    films: Sequence[Film],
    views: Sequence[View],
    network: Path,
    find: Find,
    run: Run,
) -> tuple[Calibration, FoundClocks]:
    """The cameras and the clocks of films in which one person walks about, whenever each film began.

    Sound is asked first. Where it does not tell, the joints of a few seconds about the middle of the shortest film are
    compared, which finds offsets of up to half of that.

    Raises:
        CalibrationRefused: if neither sound nor joints tell the clocks, or the joints fit no rig, or several.
        FrogError: as of ``calibrate_joint_films``.
    """
    heard = find(films, {})
    if heard.by_sound:
        timed = with_clocks(films, heard.clocks)
        common = common_times(timed, TIMES)
        return calibrate_joint_films(timed, views, common, network, run), heard
    shortest = min(float(film.stamps[-1] - film.stamps[0]) for film in films)
    interval = float(np.clip(shortest / _MOST_IMAGES, *_INTERVALS))
    window = min(shortest, _MOST_IMAGES * interval)
    spread = np.arange(0.0, window + 1e-6, interval) + (shortest - window) / 2
    times: list[Float64s] = []
    for film in films:
        after = np.searchsorted(film.stamps, film.stamps[0] + spread - 1e-6)
        times.append(film.stamps[np.unique(np.minimum(after, len(film.stamps) - 1))])
    unplaced = [replace(film, offset=0.0, rate=1.0) for film in films]
    joints = _joints_of_films(unplaced, views, [stamps.tolist() for stamps in times], network, run)
    facts = [CameraFacts(film.name, *film.size) for film in films]
    tracks = moving_tracks(facts, [NamedTracks(*film) for film in zip(times, joints, strict=True)])
    found = find(films, {film.name: track for film, track in zip(films, tracks, strict=True)})
    if found.refusal is not None:
        raise CalibrationRefused(f"The joints do not tell when the films began: {REMEDY}. {found.refusal}")
    frame = 1 / min(film.facts.frames_per_second for film in films)
    groups = [view.group for view in views]
    starts = found.likely_offsets(_MOST_STARTS)
    calibration, offsets = place_by_tracks(facts, groups, tracks, (starts, frame), run)
    return calibration, found.with_offsets(dict(zip(found.clocks, offsets.tolist(), strict=True)))


def _joints_of_films(
    films: Sequence[Film],
    views: Sequence[View],
    times: Sequence[Sequence[float]],
    network: Path,
    run: Run,
) -> list[Float64s]:
    """(T, 16, 2) joints of whoever moves in each film, at ascending capture times in seconds."""
    loaded = LandmarkNetwork(network)
    joints = []
    for index, (film, view, film_times) in enumerate(zip(films, views, times, strict=True)):
        run.progress("joints", index, len(films))
        joints.append(find_joints(loaded, images_at(film, film_times, run.check), view.background, view.changing))
    return joints


def calibrate_joints(facts: Sequence[CameraFacts], groups: Sequence[int], pixels: Float64s) -> Calibration:
    """The rig that saw a person's joints, at an arbitrary scale.

    Args:
        facts: of the cameras.
        groups: cameras of one number share their focal length.
        pixels: (C, T, 16, 2) joints at the same times; NaN where none is surely seen.

    Raises:
        CalibrationRefused: if too few joints are shared, do not fit, or leave a focal length open, or if two halves of
            the times disagree.
    """
    return _judged(facts, _rig_of(facts, groups, pixels, halves=True))


def _rig_of(
    facts: Sequence[CameraFacts],
    groups: Sequence[int],
    pixels: Float64s,
    moving: Float64s | None = None,
    *,
    start: Model | None = None,
    halves: bool = False,
) -> PointRig:
    """The rig before it is judged.

    Args:
        moving: (C, T, 16, 2) pixels a second by which the joints move, where the cameras' clocks are to be corrected.
        start: a rig near the answer, if one is known.
        halves: two halves of the times are compared.
    """
    pixels = np.where(np.isfinite(pixels[..., :1]).sum(0) < 2, np.nan, pixels)  # of no use, and no fault
    sides = np.array([camera.side for camera in facts])
    views = PointViews(facts, np.array(groups), pixels.reshape(len(facts), -1, 2), _LIMIT, REMEDY)
    for camera, count in zip(facts, views.seen.sum(1).tolist(), strict=True):
        if count < _LEAST_JOINTS:
            raise CalibrationRefused(
                f"Camera {camera.name} shares {count} joints of a person with the others, expected {_LEAST_JOINTS} or "
                f"more: {REMEDY}."
            )
    times = np.repeat(np.arange(pixels.shape[1]), len(JOINTS))
    early = 2 * times < pixels.shape[1] if halves else None

    def solved(start: Model | None) -> PointRig:
        velocities = None if moving is None else moving.reshape(len(facts), -1, 2)
        given = replace(views, pixels=pixels.reshape(len(facts), -1, 2), velocities=velocities)
        return solve_points(given, halves=early, start=start)

    fitted = solved(start)
    for _ in range(_SIDE_ROUNDS):
        cameras = [calibrated.camera for calibrated in fitted.calibration.cameras]
        pairs = combinations(range(len(cameras)), 2)
        matrices = {(one, other): fundamental(cameras[one], cameras[other]) for one, other in pairs}
        swapped = agreed_sides(pixels, matrices, float(_LIMIT * sides.max()))
        if not swapped.any():
            break
        pixels = with_sides(pixels, swapped)
        moving = None if moving is None else with_sides(moving, swapped)
        fitted = solved(fitted.model)
    return fitted


def _judged(facts: Sequence[CameraFacts], found: PointRig) -> Calibration:
    """A rig's calibration, with a warning where two halves of the times disagree a little, refused where by a lot."""
    for camera, share in zip(facts, found.shares.tolist(), strict=True):
        if share < _LEAST_SHARE:
            raise CalibrationRefused(
                f"Only {100 * share:.0f} % of the joints that camera {camera.name} sees fit the other cameras: the "
                f"films are not in step, or it sees another person; {REMEDY}."
            )
    calibration, apart = found.calibration, found.calibration.halves_apart
    if len(facts) == 2:
        warning = "Nothing but each other tests two cameras' positions: look at the result."
    elif apart > _APART:
        raise CalibrationRefused(
            f"The film's two halves put the cameras {100 * apart:.0f} % of the rig's size apart: "
            f"{REMEDY}, or hold a board into the views."
        )
    elif apart > _DOUBTFUL_APART:
        warning = f"Camera positions are known within about {100 * apart:.1f} % of the rig's size only."
    else:
        return calibration
    return replace(calibration, warnings=(*calibration.warnings, warning))


# --- clocks from joints alone


def moving_tracks(facts: Sequence[CameraFacts], tracks: Sequence[NamedTracks]) -> list[NamedTracks]:
    """Each film's joints without changes of left for right and without strays.

    Raises:
        CalibrationRefused: for a film in which too few joints move, or nothing tells left from right.
    """
    clean = []
    for camera, track in zip(facts, tracks, strict=True):
        if leaves_sides_open(track.positions):  # a wrong side fits a wrong offset as well, a stride away
            raise CalibrationRefused(
                f"In the film of camera {camera.name} nothing tells left from right, nor, therefore, when it began: "
                f"{REMEDY}."
            )
        pixels = without_strays(with_sides(track.positions, steady_sides(track.positions)))
        seen = np.isfinite(pixels[:, :, 0]).sum(0) >= _LEAST_IMAGES
        if not seen.any():
            raise CalibrationRefused(f"The film of camera {camera.name} shows no person: {REMEDY}.")
        shown = pixels[:, seen]
        ranges = np.nanmedian(np.abs(shown - np.nanmedian(shown, axis=0)), axis=0).max(1)
        moving = int((ranges > _LEAST_RANGE * float(np.median(heights(shown)))).sum())
        if moving < _LEAST_MOVING:
            raise CalibrationRefused(
                f"Only {moving} joints move in the film of camera {camera.name}, expected {_LEAST_MOVING} or more, so "
                f"that nothing tells when it began: {REMEDY}."
            )
        clean.append(replace(track, positions=pixels))
    return clean


class _Timed(NamedTuple):
    """A rig, the offsets (C,) in seconds at which the films were read for it, and the seconds that all films share."""

    rig: PointRig
    offsets: Float64s
    shared: float


def calibrate_unsynchronised(
    facts: Sequence[CameraFacts],
    groups: Sequence[int],
    tracks: Sequence[NamedTracks],
    starts: Sequence[Float64s],
    frame: float,
) -> tuple[Calibration, Float64s]:
    """The rig, and the offsets (C,) in seconds that explain a person's joints best, the least of them 0.

    Args:
        facts: of the cameras.
        groups: cameras of one number share their focal length.
        tracks: each film's joints (``moving_tracks``).
        starts: offsets (C,) in seconds that may be right to a frame or two; that all are 0 is tried as well.
        frame: seconds between frames of the slowest film.

    Raises:
        CalibrationRefused: if the joints fit no rig, or several, or leave an offset open.
    """
    answers: list[_Timed] = []
    refused: CalibrationRefused | None = None
    in_step = np.zeros(len(tracks))
    for start in (*starts, in_step) if all(np.ptp(start) >= frame for start in starts) else starts:
        try:
            answers.append(_timed(facts, groups, tracks, start))
        except CalibrationRefused as error:
            refused = refused or error
    if not answers:
        raise refused or CalibrationRefused(f"The films share too few joints of a person: {REMEDY}.")
    least = min(answer.rig.cost for answer in answers)
    good = sorted((answer for answer in answers if answer.rig.cost <= _AS_GOOD * least), key=lambda one: one.rig.cost)
    # A person who walks repeats themselves: for a second or so, cameras about them fit as well at a stride's distance
    # in time and elsewhere in space. Of answers as good, those that explain a short time have been tested less.
    longest = max(answer.shared for answer in good)
    best, *rivals = [answer for answer in good if answer.shared >= _AS_LONG * longest]
    for rival in rivals:
        if np.ptp(rival.offsets - best.offsets) >= frame:
            raise CalibrationRefused(f"The joints fit at several offsets of the films equally well: {REMEDY}.")
    sigmas = _CORRELATED * best.rig.delay_sigmas
    worst = int(np.argmax(sigmas))
    if not sigmas[worst] <= _UNSURE * frame:
        raise CalibrationRefused(
            f"The joints leave open when the film of camera {facts[worst].name} began, within "
            f"{1000 * sigmas[worst]:.0f} ms: {REMEDY}."
        )
    is_in_step = np.ptp(best.offsets) <= max(_LEAST_SHIFT * frame, 2 * float(sigmas.max()))
    offsets = in_step if is_in_step else best.offsets - best.offsets.min()
    pixels, _ = _read(tracks, offsets, _MOST_IMAGES)
    return _judged(facts, _rig_of(facts, groups, pixels, start=best.rig.model, halves=True)), offsets


def _timed(
    facts: Sequence[CameraFacts], groups: Sequence[int], tracks: Sequence[NamedTracks], start: Float64s
) -> _Timed:
    """Bundle adjustments of cameras and clocks, each from joints read at the offsets that the one before corrected."""
    offsets, rig = start, None
    for turn in range(_ROUNDS):
        pixels, moving = _read(tracks, offsets, _MOST_IMAGES if turn else _FIRST_TIMES)
        rig = _rig_of(facts, groups, pixels, moving, start=None if rig is None else rig.model)
        offsets = offsets - rig.delays
        if turn and np.ptp(rig.delays) < _SETTLED * max(track.interval for track in tracks):
            break
    assert rig is not None  # there is at least one round
    first, last = _common(tracks, offsets)
    return _Timed(rig, offsets, last - first)


def _common(tracks: Sequence[NamedTracks], offsets: Float64s) -> tuple[float, float]:
    """Capture times, in seconds, from which on and until when all films show something."""
    ends = np.array([track.times[[0, -1]] for track in tracks]) + offsets[:, None]
    return float(ends[:, 0].max()), float(ends[:, 1].min())


def _read(tracks: Sequence[NamedTracks], offsets: Float64s, most: int) -> tuple[Float64s, Float64s]:
    """(C, T, 16, 2) joints at common times, and by how many pixels a second they move."""
    (start, end), interval = _common(tracks, offsets), max(track.interval for track in tracks)
    if end < start:
        raise CalibrationRefused(f"The films share no time at which they show a person: {REMEDY}.")
    times = np.linspace(start, end, int(np.clip(round((end - start) / interval) + 1, 2, most)))
    at = [
        [track.at(times - offset + shift, _LONGEST_GAP) for shift in (-interval, 0.0, interval)]
        for track, offset in zip(tracks, offsets.tolist(), strict=True)
    ]
    early, pixels, late = np.stack(at, axis=1)
    return pixels, np.nan_to_num((late - early) / (2 * interval))
