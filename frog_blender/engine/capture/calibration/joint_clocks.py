"""The cameras and the clocks of films in which a person moves, from their joints alone, nothing else known.

``joint_lags`` guesses where the films begin. A bundle adjustment whose unknowns include the cameras' clocks decides
between the guesses, and refines the best one to a part of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Float64s
from ..synchronization.lags import NamedTracks
from .calibration import Calibration, CalibrationRefused
from .evidence import disagreement
from .joint_lags import Guess, guesses
from .joint_sides import readings_of_sides
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
_AS_GOOD = 0.1  # of the least cost, by which that of another answer may be larger; more where joints are few
_NEIGHBOURS = 4.0  # joints of successive images that count as one
_AS_LONG = 0.9  # of the longest time that answers as good explain: less is easier to fit
_SAME = 0.05  # of the rig's diameter, by which the cameras of two answers may differ
_OFTEN_SWAPPED = 0.1  # of a film's images, from which on nothing tells which part of them has left for right
_CORRELATED = 4.0  # times the standard deviation: joints of successive images err together
_SIGNIFICANT = 2.0  # standard deviations: by less, costs do not differ and films are in step
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
    """A rig, the films as they are read for it, and their offsets.

    Attributes:
        offsets: (C,) seconds.
        freedom: coordinates of joints less those of their places.
        is_full: all times count.
    """

    rig: PointRig
    films: Sequence[FilmJoints]
    offsets: Float64s
    freedom: int
    is_full: bool

    @property
    def shared(self) -> float:
        """Seconds that all films share."""
        start, end = _common(self.films, self.offsets)
        return end - start

    def fits_as_well(self, best: _Timed) -> bool:
        """Whether only chance sets it apart from an answer that costs less."""
        chance = np.sqrt(2.0 * _NEIGHBOURS / max(min(self.freedom, best.freedom), 1))  # of a variance, relative
        return self.rig.cost <= (1.0 + max(_AS_GOOD, _SIGNIFICANT * float(chance))) * best.rig.cost


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
    readings, doubtful = _steady(films)
    race = _Race(facts, groups, readings, max(float(np.median(np.diff(film.times))) for film in films))
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
    found = judged(facts, race.solved(offsets, best.films, best, is_final=True).rig)
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


def _steady(films: Sequence[FilmJoints]) -> tuple[list[list[FilmJoints]], list[bool]]:
    """Each film's readings, without changes of left for right and without strays, and where those changes were many."""
    found, doubtful = [], []
    for film in films:
        visible = film.joints.visible
        readings = readings_of_sides(visible)
        found.append([replace(film, joints=without_strays(film.joints.with_sides(swapped))) for swapped in readings])
        seen = np.isfinite(visible[:, :, 0]).any(1)
        doubtful.append(any(bool(swapped.sum() > _OFTEN_SWAPPED * seen.sum()) for swapped in readings))
    return found, doubtful


@dataclass(frozen=True, eq=False)
class _Race:
    """Guesses, refined as long as they keep up with the best one."""

    facts: Sequence[CameraFacts]
    groups: Sequence[int]
    readings: Sequence[Sequence[FilmJoints]]  # of each film
    interval: float  # seconds between the joints' times

    def run(self, doubtful: Sequence[bool]) -> list[_Timed]:
        """Answers, the best first. ``doubtful``: films in which left may be right."""
        refused: CalibrationRefused | None = None
        running: list[_Timed] = []
        for guess in self._guesses(doubtful):
            try:
                running.append(self.solved(guess.offsets, self._read(guess), None))
            except CalibrationRefused as error:
                refused = refused or error
        if not running:
            raise refused or CalibrationRefused(f"The films share too few joints of a person: {REMEDY}.")
        for _ in range(_ROUNDS):
            least = min(timed.rig.cost for timed in running)
            refined = [self._refined(timed, least) for timed in running]
            running = [timed for timed in refined if timed is not None]
        return _ranked(running)

    def _refined(self, timed: _Timed, least: float) -> _Timed | None:
        """An answer after one more round; None where it turns out to be none, unless it is the best one."""
        if not self._is_open(timed, least):
            return timed
        try:
            return self.solved(timed.offsets, timed.films, timed)
        except CalibrationRefused:
            if timed.rig.cost <= least:
                raise
            return None

    def _read(self, guess: Guess) -> list[FilmJoints]:
        """The films as a guess has them."""
        chosen = zip(self.readings, guess.readings.tolist(), guess.sides.tolist(), strict=True)
        films = [(readings[number], is_changed) for readings, number, is_changed in chosen]
        return [
            replace(film, joints=film.joints.with_sides(np.full(len(film.times), is_changed)))
            for film, is_changed in films
        ]

    def _is_open(self, timed: _Timed, least: float) -> bool:
        is_settled = timed.is_full and np.ptp(timed.rig.delays) < _SETTLED * self.interval
        return not is_settled and timed.rig.cost <= _HOPELESS * least

    def solved(
        self, offsets: Float64s, films: Sequence[FilmJoints], start: _Timed | None, *, is_final: bool = False
    ) -> _Timed:
        """One bundle adjustment from joints read at some offsets; of the clocks as well, unless they are final."""
        read = _at(films, offsets, self.interval, _MOST_TIMES if start is not None else _FIRST_TIMES)
        rig = rig_of(
            self.facts,
            self.groups,
            [joints for joints, _ in read],
            None if is_final else np.stack([moving for _, moving in read]),
            start=None if start is None else start.rig.rig,
            halves=is_final,
        )
        seen = np.stack([np.isfinite(joints.visible[:, :, 0]) for joints, _ in read]).sum(0)
        freedom = int((2 * seen - 3)[seen > 1].sum())
        return _Timed(rig, films, offsets - rig.delays, freedom, start is not None)

    def _guesses(self, doubtful: Sequence[bool]) -> list[Guess]:
        """The likeliest ones, and that the films are in step."""
        tracks = [[NamedTracks(film.times, film.joints.visible) for film in films] for films in self.readings]
        side = max(camera.side for camera in self.facts)
        found = guesses(tracks, doubtful, self.interval, side, _GUESSES)
        if any(np.ptp(guess.offsets) < self.interval for guess in found):
            return found
        count = len(tracks)
        return [*found, Guess(np.zeros(count), np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool), 0.0)]


def _ranked(running: Sequence[_Timed]) -> list[_Timed]:
    """The best answer, then the others by cost.

    A person who walks repeats themselves: for a second or so, cameras about them fit as well at a stride's distance in
    time and elsewhere in space. Of answers that fit as well, those that explain a short time have been tested less.
    """
    ordered = sorted(running, key=lambda timed: timed.rig.cost)
    good = [timed for timed in ordered if timed.fits_as_well(ordered[0])]
    longest = max(timed.shared for timed in good)
    best = next(timed for timed in good if timed.shared >= _AS_LONG * longest)
    return [best, *(timed for timed in ordered if timed is not best)]


def _common(films: Sequence[FilmJoints], offsets: Float64s) -> tuple[float, float]:
    """Capture times, in seconds, from which on and until when all films show something."""
    ends = np.array([film.times[[0, -1]] for film in films]) + offsets[:, None]
    return float(ends[:, 0].max()), float(ends[:, 1].min())


def _at(films: Sequence[FilmJoints], offsets: Float64s, interval: float, most: int) -> list[tuple[Joints, Float64s]]:
    """Each film's joints at common times, and (T, 16, 2) pixels a second by which they move."""
    start, end = _common(films, offsets)
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
    """A warning for each other answer that is as good: with the same rig at other times, or tested by less time.

    Raises:
        CalibrationRefused: if one has another rig, and explains as much.
    """
    sentences = []
    for other in others:
        if not other.fits_as_well(best) or np.ptp(other.offsets - best.offsets) < frame:
            continue
        moved = other.offsets - best.offsets
        film = int(np.argmax(np.abs(moved - np.median(moved))))
        by = 1000 * (moved[film] - float(np.median(moved)))
        if disagreement(_model(best), _model(other)) <= _SAME:
            sentences.append(f"The film of camera {facts[film].name} may as well have begun {by:+.0f} ms from there.")
        elif other.shared < _AS_LONG * best.shared:
            sentences.append(
                f"For the {other.shared:.1f} s that films then share, the joints fit as well with the film of camera "
                f"{facts[film].name} {by:+.0f} ms from there: look at the result."
            )
        else:
            raise CalibrationRefused(
                f"The joints fit two rigs equally well, with the film of camera {facts[film].name} {by:+.0f} ms apart: "
                f"{REMEDY}."
            )
    return sentences


def _model(timed: _Timed) -> Model:
    cameras = [each.camera for each in timed.rig.calibration.cameras]
    lenses = tuple(Lens(each.width, each.height, float(each.intrinsics[0, 0])) for each in cameras)
    return Model(np.stack([each.world_to_camera[:3] for each in cameras]), lenses)
