"""The answer: each camera's offset and rate, how sure they are, and what a person should know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...io.plain_values import UnfitValue, number, typed
from . import limits
from .films import Clocks, Film
from .pairs import Curve, Source

_LONGEST = 1e7  # seconds: no offset lies beyond
_RATES = (0.5, 2.0)
_IN_STEP = 0.1  # of a frame: films that begin within it began together
_SAME_RATE = 1e-4


@dataclass(frozen=True)
class RunnerUp:
    """Another offset that fits a camera, seconds, and its score as a share of the best one's."""

    offset: float
    share: float

    @property
    def is_as_likely(self) -> bool:
        """Its score comes within a tenth of the best."""
        return self.share >= limits.RIVAL


@dataclass(frozen=True, eq=False)
class CameraClock:
    """One camera's clock: capture time = ``offset`` + ``rate`` * film time.

    Attributes:
        name: the camera.
        offset: seconds of capture time at the film's time 0.
        rate: seconds of capture time for each second of film.
        confidence: 0 to 1; below 0.5 a person should look at the curve.
        sources: who contributed, such as ("motion",).
        runner_up: the next best offset, if the curve has another maximum.
        curve: the score over the camera's offset (seconds), all other cameras held.
    """

    name: str
    offset: float
    rate: float
    confidence: float
    sources: tuple[Source, ...]
    runner_up: RunnerUp | None
    curve: Curve


@dataclass(frozen=True, eq=False)
class Synchronization:
    """The clocks of a capture's cameras; none where they were given or assumed.

    Attributes:
        cameras: in the order of the films.
        frame: seconds between frames of the slowest film: the unit of "half a frame" below.
        residual: seconds by which the pairs of films miss the clocks (median).
        warnings: sentences for the user.
        refusal: a sentence, where the offsets must not be used; else None.
    """

    cameras: tuple[CameraClock, ...] = ()
    frame: float = 1.0
    residual: float = 0.0
    warnings: tuple[str, ...] = ()
    refusal: str | None = None

    @property
    def clocks(self) -> Clocks:
        """Offset in seconds, and seconds of capture time for each second of film, by camera."""
        return {camera.name: (camera.offset, camera.rate) for camera in self.cameras}

    @property
    def by_sound(self) -> bool:
        """Whether sound alone told the clocks of all films."""
        return self.refusal is None and all(camera.sources == ("audio",) for camera in self.cameras)

    def with_clocks(self, clocks: Clocks) -> Synchronization:
        """The same with other clocks for all cameras, such as offsets that were measured closer."""
        cameras = (
            replace(camera, offset=clocks[camera.name][0], rate=clocks[camera.name][1]) for camera in self.cameras
        )
        return replace(self, cameras=tuple(cameras))


def read_synchronization(value: object) -> Synchronization:
    """What a report says of a synchronisation; UnfitValue for anything else."""
    answer: Synchronization = typed(Synchronization, value, "a synchronisation")
    number(answer.frame, "the frame interval", 1e-6, 1e4)
    for camera in answer.cameras:
        what = f"of camera {camera.name}"
        number(camera.offset, f"the offset {what}", -_LONGEST, _LONGEST)
        number(camera.rate, f"the rate {what}", *_RATES)
        number(camera.confidence, f"the confidence {what}", 0, 1)
        if camera.runner_up is not None:
            number(camera.runner_up.offset, f"the runner-up's offset {what}", -_LONGEST, _LONGEST)
        offsets, scores = camera.curve.lags, camera.curve.scores
        if offsets.shape != scores.shape or offsets.ndim != 1 or not np.isfinite(offsets).all():
            raise UnfitValue(f"the curve {what} of {offsets.shape} offsets and {scores.shape} scores", "one of each")
    return answer


def in_step(answer: Synchronization, films: Sequence[Film]) -> Synchronization:
    """The same with equal clocks where all began together and ran alike: what is left is the error of finding it."""
    offsets, rates = zip(*answer.clocks.values(), strict=True)
    frame = 1 / max(film.facts.frames_per_second for film in films)
    if max(offsets) - min(offsets) < 2 * _IN_STEP * frame and all(abs(rate - 1) < _SAME_RATE for rate in rates):
        return answer.with_clocks(dict.fromkeys(answer.clocks, (0.0, 1.0)))
    return answer


def differ(one: Clocks, other: Clocks, films: Sequence[Film]) -> bool:
    """Whether any film's clock differs by more than a tenth of a frame at its start."""
    return any(
        abs(one[film.name][0] - other[film.name][0]) * film.facts.frames_per_second > _IN_STEP
        for film in films
        if film.name in one and film.name in other
    )
