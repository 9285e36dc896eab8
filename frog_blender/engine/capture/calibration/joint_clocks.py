"""The cameras and the clocks of films in which a person moves, from their joints alone, nothing else known.

``joint_lags`` guesses where the films begin. A bundle adjustment whose unknowns include the cameras' clocks decides
between the guesses, and refines the best one to a part of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float64s
from ..synchronization.lags import NamedTracks
from .calibration import Calibration, CalibrationRefused
from .evidence import disagreement
from .joint_lags import Guess, guesses
from .joint_sides import steady_sides
from .joints import REMEDY, Joints, judged, rig_of
from .lens import Lens
from .mapping import Model
from .point_rig import PointRig
from .rig_result import CameraFacts
from .rig_solver import Rig

_GUESSES = 3
_ROUNDS = 3  # of reading joints at corrected times
_MOST_TIMES = 80
_SETTLED = 2e-4  # seconds
_HOPELESS = 1.5  # of the least cost: a guess that is not refined further
_AS_GOOD = 1.1  # of the least cost: another answer
_SAME = 0.05  # of the rig's diameter, by which the cameras of two answers may differ
_OFTEN_SWAPPED = 0.1  # of a film's images, from which on nothing tells which part of them has left for right
_CORRELATED = 4.0  # times the standard deviation: joints of successive images err together
_LEAST_SHIFT = 0.2  # frames by which films must differ to be out of step
_UNSURE, _DOUBTFUL = 0.5, 0.3  # frames of standard deviation of an offset


@dataclass(frozen=True, eq=False)
class FilmJoints:
    """A person's joints in one film at (T,) ascending film times in seconds; ``frame`` is what its frames last."""

    times: Float64s
    joints: Joints
    frame: float


@dataclass(frozen=True, eq=False)
class JointClocks:
    """What a person's joints say.

    Attributes:
        calibration: the cameras, with what is in doubt among its warnings.
        offsets: (C,) seconds; capture time = offset + film time. The least is 0; all are 0 for films in step.
        sigmas: (C,) seconds of standard deviation.
    """

    calibration: Calibration
    offsets: Float64s
    sigmas: Float64s


@dataclass(frozen=True, eq=False)
class _Timed:
    rig: PointRig
    offsets: Float64s
    sigmas: Float64s


def calibrate_unsynchronised(
    facts: Sequence[CameraFacts], groups: Sequence[int], films: Sequence[FilmJoints]
) -> JointClocks:
    """The rig and the offsets that explain a person's joints in films that began whenever.

    Args:
        facts: of the cameras.
        groups: cameras of one number share their focal length.
        films: each one's joints, a few images a step apart at most.

    Raises:
        CalibrationRefused: if the joints fit no rig, or several, or leave an offset open.
    """
    interval = max(float(np.median(np.diff(film.times))) for film in films)
    steady, doubtful = _steady(films)
    tracks = [NamedTracks(film.times, film.joints.visible) for film in steady]
    tried = guesses(tracks, doubtful, interval, max(camera.side for camera in facts), _GUESSES)
    if not any(np.ptp(guess.offsets) < interval for guess in tried):
        tried.append(Guess(np.zeros(len(films)), np.zeros(len(films), dtype=bool), 0.0))
    best, *others = _raced(facts, groups, steady, tried, interval)
    frame = max(film.frame for film in films)
    warnings = _rivals(facts, best, others, frame)
    sigmas = _CORRELATED * best.sigmas
    if np.ptp(best.offsets) <= max(_LEAST_SHIFT * frame, float(sigmas.max())):
        offsets = np.zeros(len(films))
        rig = rig_of(facts, groups, [joints for joints, _ in _at(steady, offsets, interval)])
    else:
        offsets, rig = best.offsets - best.offsets.min(), best.rig
    found = judged(facts, rig)
    worst = int(np.argmax(sigmas))
    if not sigmas[worst] <= _UNSURE * frame:
        raise CalibrationRefused(
            f"The joints leave open when the film of camera {facts[worst].name} began, within "
            f"{1000 * sigmas[worst]:.0f} ms: {REMEDY}."
        )
    if sigmas[worst] > _DOUBTFUL * frame:
        warnings.append(
            f"The offset of camera {facts[worst].name} is known within about {1000 * sigmas[worst]:.0f} ms only."
        )
    return JointClocks(replace(found, warnings=(*found.warnings, *warnings)), offsets, sigmas)


def _steady(films: Sequence[FilmJoints]) -> tuple[list[FilmJoints], list[bool]]:
    """The films without changes of left for right, and in which of them those were many."""
    found, doubtful = [], []
    for film in films:
        visible = film.joints.visible
        swapped = steady_sides(visible)
        found.append(replace(film, joints=film.joints.with_sides(swapped)))
        seen = np.isfinite(visible[:, :, 0]).any(1)
        doubtful.append(bool(swapped.sum() > _OFTEN_SWAPPED * seen.sum()))
    return found, doubtful


def _raced(
    facts: Sequence[CameraFacts],
    groups: Sequence[int],
    films: Sequence[FilmJoints],
    tried: Sequence[Guess],
    interval: float,
) -> list[_Timed]:
    """Answers, the best first: each guess is refined as long as it keeps up with the best one."""
    refused: CalibrationRefused | None = None
    running: list[tuple[_Timed, Bools]] = []
    for guess in tried:
        try:
            running.append((_stepped(facts, groups, films, guess.offsets, guess.sides, interval), guess.sides))
        except CalibrationRefused as error:
            refused = refused or error
    if not running:
        raise refused or CalibrationRefused(f"The films share too few joints of a person: {REMEDY}.")
    for _ in range(_ROUNDS - 1):
        least = min(timed.rig.cost for timed, _ in running)
        following = []
        for timed, sides in running:
            is_open = timed.rig.cost <= _HOPELESS * least and np.abs(timed.rig.delays).max() > _SETTLED
            if is_open:
                timed = _stepped(facts, groups, films, timed.offsets, sides, interval, timed.rig.rig)
            following.append((timed, sides))
        running = following
    return sorted((timed for timed, _ in running), key=lambda timed: timed.rig.cost)


def _stepped(
    facts: Sequence[CameraFacts],
    groups: Sequence[int],
    films: Sequence[FilmJoints],
    offsets: Float64s,
    sides: Bools,
    interval: float,
    start: Rig | None = None,
) -> _Timed:
    """One bundle adjustment of cameras, points and clocks, from joints read at some offsets."""
    chosen = [
        replace(film, joints=film.joints.with_sides(np.full(len(film.times), is_changed)))
        for film, is_changed in zip(films, sides.tolist(), strict=True)
    ]
    read = _at(chosen, offsets, interval)
    moving = np.stack([moving for _, moving in read])
    rig = rig_of(facts, groups, [joints for joints, _ in read], moving, start=start)
    return _Timed(rig, offsets - rig.delays, rig.delay_sigmas)


def _at(films: Sequence[FilmJoints], offsets: Float64s, interval: float) -> list[tuple[Joints, Float64s]]:
    """Each film's joints at common times, and (T, 16, 2) pixels a second by which they move."""
    ends = np.array([film.times[[0, -1]] for film in films]) + offsets[:, None]
    start, end = float(ends[:, 0].max()), float(ends[:, 1].min())
    if end < start:
        raise CalibrationRefused(f"The films share no time at which they show a person: {REMEDY}.")
    times = np.linspace(start, end, int(np.clip((end - start) / interval + 1, 2, _MOST_TIMES)))
    found = []
    for film, offset in zip(films, offsets.tolist(), strict=True):
        wanted = np.clip(times - offset, *film.times[[0, -1]])
        sides = [np.clip(wanted + side * interval / 4, *film.times[[0, -1]]) for side in (-1, 1)]
        early, late = (film.joints.at(film.times, side).pixels for side in sides)
        moving = (late - early) / np.maximum(sides[1] - sides[0], 1e-9)[:, None, None]
        found.append((film.joints.at(film.times, wanted), np.nan_to_num(moving)))
    return found


def _rivals(facts: Sequence[CameraFacts], best: _Timed, others: Sequence[_Timed], frame: float) -> list[str]:
    """A warning for each other answer that is as good, with the same rig at other times.

    Raises:
        CalibrationRefused: if one has another rig.
    """
    sentences = []
    for other in others:
        if other.rig.cost > _AS_GOOD * best.rig.cost or np.ptp(other.offsets - best.offsets) < frame:
            continue
        moved = other.offsets - best.offsets
        film = int(np.argmax(np.abs(moved - np.median(moved))))
        by = 1000 * (moved[film] - float(np.median(moved)))
        if disagreement(_model(best), _model(other)) > _SAME:
            raise CalibrationRefused(
                f"The joints fit two rigs equally well, with the film of camera {facts[film].name} {by:+.0f} ms apart: "
                f"{REMEDY}."
            )
        sentences.append(f"The film of camera {facts[film].name} may as well have begun {by:+.0f} ms from there.")
    return sentences


def _model(timed: _Timed) -> Model:
    cameras = [each.camera for each in timed.rig.calibration.cameras]
    lenses = tuple(Lens(each.width, each.height, float(each.intrinsics[0, 0])) for each in cameras)
    return Model(np.stack([each.world_to_camera[:3] for each in cameras]), lenses)
