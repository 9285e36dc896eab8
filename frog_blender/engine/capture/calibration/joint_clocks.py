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
from .joints import REMEDY, Joints, judged, rig_of, without_strays
from .lens import Lens
from .mapping import Model
from .point_rig import PointRig
from .rig_result import CameraFacts

_GUESSES = 3
_ROUNDS = 5  # of reading joints at corrected times
_SETTLED = 0.02  # of the interval
_FIRST_TIMES, _MOST_TIMES = 30, 80  # at which joints are compared, in the first round and in later ones
_LEAST_IMAGES = 10  # of a joint
_LEAST_MOVING = 6  # joints
_ABOVE_NOISE = 3.0  # times: how far a joint that moves goes, as a median
_LEAST_RANGE = 0.01  # of the person's height
_BEND = 1.65  # the median second difference of three places that are each uncertain by 1
_HOPELESS = 1.5  # of the least cost: a guess that is not refined further
_AS_GOOD = 1.1  # of the least cost: another answer
_SAME = 0.05  # of the rig's diameter, by which the cameras of two answers may differ
_OFTEN_SWAPPED = 0.1  # of a film's images, from which on nothing tells which part of them has left for right
_CORRELATED = 4.0  # times the standard deviation: joints of successive images err together
_SIGNIFICANT = 2.0  # standard deviations by which films must differ to be out of step
_LEAST_SHIFT = 0.2  # frames by which they must differ as well
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
    """A rig, the offsets (C,) of its films in seconds, (C,) in which of them left is right, and if all times count."""

    rig: PointRig
    offsets: Float64s
    sides: Bools
    is_full: bool


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
    _check_motion(facts, films)
    steady, doubtful = _steady(films)
    race = _Race(facts, groups, steady, max(float(np.median(np.diff(film.times))) for film in films))
    frame = max(film.frame for film in films)
    best, *others = race.run(doubtful)
    warnings = _rivals(facts, best, others, frame)
    sigmas = _CORRELATED * best.rig.delay_sigmas
    offsets, is_in_step = (
        best.offsets,
        np.ptp(best.offsets) <= max(_LEAST_SHIFT * frame, _SIGNIFICANT * float(sigmas.max())),
    )
    if is_in_step:
        offsets = np.zeros(len(films))
    found = judged(facts, race.solved(offsets, best, is_final=True).rig)
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
    found = replace(found, warnings=(*found.warnings, *warnings))
    return JointClocks(found, offsets - offsets.min(), sigmas)


def _check_motion(facts: Sequence[CameraFacts], films: Sequence[FilmJoints]) -> None:
    """Refuses films in which too few joints move: the network's noise would be taken for motion."""
    for camera, film in zip(facts, films, strict=True):
        visible = film.joints.visible
        seen = np.isfinite(visible[:, :, 0]).sum(0) >= _LEAST_IMAGES
        if not seen.any():
            raise CalibrationRefused(f"The film of camera {camera.name} shows no person: {REMEDY}.")
        places = visible[:, seen]
        bends = np.abs(places[2:] - 2.0 * places[1:-1] + places[:-2])
        noise = np.nanmedian(bends, axis=(0, 2)) / _BEND
        ranges = np.nanmedian(np.abs(places - np.nanmedian(places, axis=0)), axis=0).max(1)
        rows = places[np.isfinite(places[:, :, 0]).any(1), :, 1]
        size = float(np.median(np.nanmax(rows, axis=1) - np.nanmin(rows, axis=1)))
        moving = int((ranges > np.maximum(_ABOVE_NOISE * noise, _LEAST_RANGE * size)).sum())
        if moving < _LEAST_MOVING:
            raise CalibrationRefused(
                f"Only {moving} joints move in the film of camera {camera.name}, expected {_LEAST_MOVING} or more, so "
                f"that nothing tells when it began: {REMEDY}."
            )


def _steady(films: Sequence[FilmJoints]) -> tuple[list[FilmJoints], list[bool]]:
    """The films without changes of left for right and without strays, and in which of them those changes were many."""
    found, doubtful = [], []
    for film in films:
        visible = film.joints.visible
        swapped = steady_sides(visible)
        found.append(replace(film, joints=without_strays(film.joints.with_sides(swapped))))
        seen = np.isfinite(visible[:, :, 0]).any(1)
        doubtful.append(bool(swapped.sum() > _OFTEN_SWAPPED * seen.sum()))
    return found, doubtful


@dataclass(frozen=True, eq=False)
class _Race:
    """Guesses, refined as long as they keep up with the best one."""

    facts: Sequence[CameraFacts]
    groups: Sequence[int]
    films: Sequence[FilmJoints]
    interval: float  # seconds between the joints' times

    def run(self, doubtful: Sequence[bool]) -> list[_Timed]:
        """Answers, the best first. ``doubtful``: films in which left may be right."""
        refused: CalibrationRefused | None = None
        running: list[_Timed] = []
        for guess in self._guesses(doubtful):
            try:
                running.append(self.solved(guess.offsets, None, guess.sides))
            except CalibrationRefused as error:
                refused = refused or error
        if not running:
            raise refused or CalibrationRefused(f"The films share too few joints of a person: {REMEDY}.")
        for _ in range(_ROUNDS):
            least = min(timed.rig.cost for timed in running)
            running = [self.solved(timed.offsets, timed) if self._is_open(timed, least) else timed for timed in running]
        return sorted(running, key=lambda timed: timed.rig.cost)

    def _is_open(self, timed: _Timed, least: float) -> bool:
        is_settled = timed.is_full and np.ptp(timed.rig.delays) < _SETTLED * self.interval
        return not is_settled and timed.rig.cost <= _HOPELESS * least

    def solved(
        self, offsets: Float64s, start: _Timed | None, sides: Bools | None = None, *, is_final: bool = False
    ) -> _Timed:
        """One bundle adjustment from joints read at some offsets; of the clocks as well, unless they are final."""
        if start is not None:
            sides = start.sides
        sides = np.zeros(len(self.films), dtype=bool) if sides is None else sides
        chosen = [
            replace(film, joints=film.joints.with_sides(np.full(len(film.times), is_changed)))
            for film, is_changed in zip(self.films, sides.tolist(), strict=True)
        ]
        read = _at(chosen, offsets, self.interval, _MOST_TIMES if start is not None else _FIRST_TIMES)
        rig = rig_of(
            self.facts,
            self.groups,
            [joints for joints, _ in read],
            None if is_final else np.stack([moving for _, moving in read]),
            start=None if start is None else start.rig.rig,
            halves=is_final,
        )
        return _Timed(rig, offsets - rig.delays, sides, start is not None)

    def _guesses(self, doubtful: Sequence[bool]) -> list[Guess]:
        """The likeliest ones, and that the films are in step."""
        tracks = [NamedTracks(film.times, film.joints.visible) for film in self.films]
        side = max(camera.side for camera in self.facts)
        found = guesses(tracks, doubtful, self.interval, side, _GUESSES)
        if any(np.ptp(guess.offsets) < self.interval for guess in found):
            return found
        return [*found, Guess(np.zeros(len(tracks)), np.zeros(len(tracks), dtype=bool), 0.0)]


def _at(films: Sequence[FilmJoints], offsets: Float64s, interval: float, most: int) -> list[tuple[Joints, Float64s]]:
    """Each film's joints at common times, and (T, 16, 2) pixels a second by which they move."""
    ends = np.array([film.times[[0, -1]] for film in films]) + offsets[:, None]
    start, end = float(ends[:, 0].max()), float(ends[:, 1].min())
    if end < start:
        raise CalibrationRefused(f"The films share no time at which they show a person: {REMEDY}.")
    times = np.linspace(start, end, int(np.clip(round((end - start) / interval) + 1, 2, most)))
    found = []
    for film, offset in zip(films, offsets.tolist(), strict=True):
        wanted = np.clip(times - offset, *film.times[[0, -1]])
        sides = [np.clip(wanted + side * interval, *film.times[[0, -1]]) for side in (-1, 1)]
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
