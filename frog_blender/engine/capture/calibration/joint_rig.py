"""Cameras from the joints of a person who walks about before them: for views too far apart to share features.

A joint lies some 20 pixels off where it is seen from elsewhere; hundreds of them average that out. Clocks come from
elsewhere: they are given, or heard. Only films without sound are timed by the joints themselves, whose tracks the
synchronization compares; a bundle adjustment whose unknowns include the clocks decides between the offsets that it
leaves open, and refines them to a part of a frame.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ..epipolar import fundamental
from ..synchronization.films import CalibrationRefused, Film, Run, with_clocks
from ..synchronization.starts import NamedTracks
from ..synchronization.synchronization import Synchronization, find_clocks
from . import limits
from .checks import calibration_of
from .colmap import Adjusted, adjust
from .joints import JOINTS, LandmarkNetwork, agreed_sides, cleaned, find_joints, heights, leaves_sides_open, with_sides
from .model import Calibration, Model, disagreement
from .points import clock_steps, solve_points
from .views import ALMOST, CameraFacts, common_times, images_at, views_of

_TIMES = 40  # common ones at which joints are looked for: 30 are enough; each costs a quarter of a second a camera
REMEDY = "film one person who walks about alone for ten seconds or more, near and far, where all cameras see them whole"
_SIDE_ROUNDS = 2  # of asking the other cameras which side is left
# Clocks from joints alone.
_MOST_IMAGES = 80  # of each film
_INTERVALS = (1 / 30, 0.1)  # seconds between them: a walking person's joints are known between them
_LONGEST_GAP = 0.25  # seconds between two images across which a joint is interpolated
_ROUNDS = 6  # of reading joints at corrected times
_SETTLED = 0.02  # of the interval
_FIRST_TIMES = 30  # at which joints are compared in the first round


def calibrate_joint_films(run: Run, network: Path, films: Sequence[Film], _count: int = 0) -> Calibration:
    """The cameras of films in which one person walks about, from their joints at common times.

    Args:
        network: the landmark file (``landmark_file``).

    Raises:
        CalibrationRefused: see ``calibrate_joints``.
        FrogError: for a film that cannot be decoded, or another file than the network's.
    """
    views = views_of(run, films, alike=ALMOST)
    joints = _joints_of_films(run, films, views, [common_times(films, _TIMES)] * len(films), network)
    return run.in_child(calibrate_joints, views, np.stack(joints), None)


def calibrate_unsynchronized_films(
    run: Run, network: Path, films: Sequence[Film]
) -> tuple[Calibration, Synchronization]:
    """The cameras and the clocks of films in which one person walks about, whenever each film began.

    Sound is asked first. Where it does not tell, the joints of a few seconds about the middle of the shortest film are
    compared, which finds offsets of up to half of that.

    Raises:
        CalibrationRefused: if neither sound nor joints tell the clocks, or the joints fit no rig, or several.
        FrogError: as of ``calibrate_joint_films``.
    """
    heard = find_clocks(run, films, tracks={})
    if heard.by_sound:
        return calibrate_joint_films(run, network, with_clocks(films, heard.clocks)), heard
    views = views_of(run, films, alike=ALMOST)
    shortest = min(film.duration for film in films)
    interval = float(np.clip(shortest / _MOST_IMAGES, *_INTERVALS))
    window = min(shortest, _MOST_IMAGES * interval)
    spread = np.arange(0.0, window + 1e-6, interval) + (shortest - window) / 2
    times: list[Float64s] = []
    for film in films:
        after = np.searchsorted(film.stamps, film.stamps[0] + spread - 1e-6)
        times.append(film.stamps[np.unique(np.minimum(after, len(film.stamps) - 1))])
    joints = _joints_of_films(run, films, views, [stamps.tolist() for stamps in times], network)
    seen = [NamedTracks(*film) for film in zip(times, joints, strict=True)]
    tracks = moving_tracks(views, seen)
    frame = 1 / min(film.facts.frames_per_second for film in films)
    is_open = any(leaves_sides_open(track.positions) for track in seen)
    if is_open:
        # A wrong side fits a wrong offset as well, a stride away: the films may be in step, and nothing else.
        start, clocks = np.zeros(len(films)), replace(heard, refusal=None)
    else:
        clocks = find_clocks(run, films, tracks={film.name: track for film, track in zip(films, tracks, strict=True)})
        if clocks.refusal is not None:
            raise CalibrationRefused(f"The joints do not tell when the films began: {REMEDY}. {clocks.refusal}")
        start = np.array([clocks.clocks[film.name][0] for film in films])
    calibration, offsets = run.in_child(calibrate_unsynchronized, views, tracks, start, frame)
    if is_open and offsets.any():
        raise CalibrationRefused(f"In one of the films nothing tells left from right, nor when it began: {REMEDY}.")
    own_clocks = {film.name: (offset, 1.0) for film, offset in zip(films, offsets.tolist(), strict=True)}
    return calibration, replace(clocks.with_clocks(own_clocks), warnings=())


def _joints_of_films(
    run: Run, films: Sequence[Film], views: Sequence[CameraFacts], times: Sequence[Sequence[float]], network: Path
) -> list[Float64s]:
    """(T, 16, 2) joints of whoever moves in each film, at ascending capture times in seconds."""
    loaded = LandmarkNetwork(network)
    joints = []
    for index, (film, file, film_times) in enumerate(zip(films, views, times, strict=True)):
        run.progress("joints", index, len(films))
        view = file.view(run.work)
        joints.append(find_joints(loaded, images_at(film, film_times, run.check), view.background, view.changing))
    return joints


def _rig_of(
    facts: Sequence[CameraFacts], pixels: Float64s, moving: Float64s, start: Model | None
) -> tuple[Adjusted, Float64s]:
    """The rig before it is judged, and the movements with left for right where the cameras agree about that.

    Args:
        moving: (C, T, 16, 2) pixels a second by which the joints move.
        start: a rig near the answer, if one is known.
    """
    pixels = np.where(np.isfinite(pixels[..., :1]).sum(0) < 2, np.nan, pixels)  # of no use, and no fault
    for camera, count in zip(facts, np.isfinite(pixels[..., 0]).sum((1, 2)).tolist(), strict=True):
        if count < limits.JOINTS:
            raise CalibrationRefused(
                f"Camera {camera.name} shares {count} joints of a person with the others, expected {limits.JOINTS} or "
                f"more: {REMEDY}."
            )
    for _ in range(1 + _SIDE_ROUNDS):
        rig = solve_points(facts, pixels.reshape(len(facts), -1, 2), limits.JOINT_FALSE, REMEDY, start)
        cameras = [lens.camera("", pose) for lens, pose in zip(rig.model.lenses, rig.model.poses, strict=True)]
        pairs = combinations(range(len(cameras)), 2)
        matrices = {(one, other): fundamental(cameras[one], cameras[other]) for one, other in pairs}
        swapped = agreed_sides(pixels, matrices, limits.JOINT_FALSE * max(camera.side for camera in facts))
        if not swapped.any():
            break
        pixels, moving, start = with_sides(pixels, swapped), with_sides(moving, swapped), rig.model
    return rig, moving


def calibrate_joints(facts: Sequence[CameraFacts], pixels: Float64s, start: Model | None = None) -> Calibration:
    """The rig that saw a person's joints, at an arbitrary scale; a warning where two halves of the times disagree.

    Args:
        facts: of the cameras.
        pixels: (C, T, 16, 2) joints at the same times; NaN where none is surely seen.
        start: a rig near the answer, if one is known.

    Raises:
        CalibrationRefused: if too few joints are shared, do not fit, or leave a focal length open, or if two halves of
            the times disagree by a lot.
    """
    rig, _ = _rig_of(facts, pixels, np.zeros_like(pixels), start)
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


# --- clocks from joints alone


def moving_tracks(facts: Sequence[CameraFacts], tracks: Sequence[NamedTracks]) -> list[NamedTracks]:
    """Each film's joints without changes of left for right and without strays.

    Raises:
        CalibrationRefused: for a film in which too few joints move.
    """
    clean = []
    for camera, track in zip(facts, tracks, strict=True):
        pixels = cleaned(track.positions)
        seen = np.isfinite(pixels[:, :, 0]).sum(0) >= limits.JOINT_IMAGES
        if not seen.any():
            raise CalibrationRefused(f"The film of camera {camera.name} shows no person: {REMEDY}.")
        shown = pixels[:, seen]
        ranges = np.nanmedian(np.abs(shown - np.nanmedian(shown, axis=0)), axis=0).max(1)
        moving = int((ranges > limits.JOINT_RANGE * float(np.median(heights(shown)))).sum())
        if moving < limits.JOINTS_MOVING:
            raise CalibrationRefused(
                f"Only {moving} joints move in the film of camera {camera.name}, expected {limits.JOINTS_MOVING} or "
                f"more, so that nothing tells when it began: {REMEDY}."
            )
        clean.append(replace(track, positions=pixels))
    return clean


def calibrate_unsynchronized(
    facts: Sequence[CameraFacts], tracks: Sequence[NamedTracks], start: Float64s, frame: float
) -> tuple[Calibration, Float64s]:
    """The rig, and the offsets (C,) in seconds that explain a person's joints best, the least of them 0.

    Args:
        facts: of the cameras.
        tracks: each film's joints (``moving_tracks``).
        start: offsets (C,) in seconds that may be right to a frame or two; that all are 0 is tried as well.
        frame: seconds between frames of the slowest film.

    Raises:
        CalibrationRefused: if the joints fit no rig, or two, or leave an offset open.
    """
    answers: list[tuple[Adjusted, Float64s, Float64s]] = []
    refused: list[CalibrationRefused] = []
    in_step = np.zeros(len(tracks))
    for offsets in (start, in_step) if np.ptp(start) >= frame else (start,):
        try:
            answers.append(_timed(facts, tracks, offsets))
        except CalibrationRefused as error:
            refused.append(error)
    if not answers:
        raise refused[0]
    (best, offsets, sigmas), *rivals = sorted(answers, key=lambda answer: answer[0].cost)
    for rival, other, _ in rivals:
        if rival.cost <= limits.JOINTS_AS_GOOD * best.cost and np.ptp(other - offsets) >= frame:
            raise CalibrationRefused(f"The joints fit at several offsets of the films equally well: {REMEDY}.")
    sigmas = limits.JOINT_CORRELATED * sigmas
    worst = int(np.argmax(sigmas))
    if not sigmas[worst] <= limits.JOINT_UNSURE * frame:
        raise CalibrationRefused(
            f"The joints leave open when the film of camera {facts[worst].name} began, within "
            f"{1000 * sigmas[worst]:.0f} ms: {REMEDY}."
        )
    is_in_step = np.ptp(offsets) <= max(limits.JOINT_SHIFT * frame, 2 * float(sigmas.max()))
    offsets = in_step if is_in_step else offsets - offsets.min()
    pixels, _ = _read(tracks, offsets, _MOST_IMAGES)
    return calibrate_joints(facts, pixels, best.model), offsets


def _timed(
    facts: Sequence[CameraFacts], tracks: Sequence[NamedTracks], offsets: Float64s
) -> tuple[Adjusted, Float64s, Float64s]:
    """A rig, offsets (C,) and their standard deviations: of adjustments, each of joints read at corrected offsets."""
    model, interval = None, max(track.interval for track in tracks)
    for turn in range(_ROUNDS):
        pixels, moving = _read(tracks, offsets, _MOST_IMAGES if turn else _FIRST_TIMES)
        rig, moving = _rig_of(facts, pixels, moving, model)
        velocities = moving.reshape(len(facts), -1, 2)[rig.tracks.cameras, rig.tracks.features]
        delays, sigmas = clock_steps(rig, velocities, [camera.group for camera in facts])
        model, offsets = rig.model, offsets - delays.clip(-interval, interval)
        if turn and np.ptp(delays) < _SETTLED * interval:
            break
    return rig, offsets, sigmas


def _read(tracks: Sequence[NamedTracks], offsets: Float64s, most: int) -> tuple[Float64s, Float64s]:
    """(C, T, 16, 2) joints at common times, and by how many pixels a second they move."""
    interval = max(track.interval for track in tracks)
    start = max(float(track.times[0] + offset) for track, offset in zip(tracks, offsets, strict=True))
    end = min(float(track.times[-1] + offset) for track, offset in zip(tracks, offsets, strict=True))
    if end < start:
        raise CalibrationRefused(f"The films share no time at which they show a person: {REMEDY}.")
    times = np.linspace(start, end, int(np.clip(round((end - start) / interval) + 1, 2, most)))
    at = [
        [track.at(times - offset + shift, _LONGEST_GAP) for shift in (-interval, 0.0, interval)]
        for track, offset in zip(tracks, offsets.tolist(), strict=True)
    ]
    early, pixels, late = np.stack(at, axis=1)
    return pixels, np.nan_to_num((late - early) / (2 * interval))
