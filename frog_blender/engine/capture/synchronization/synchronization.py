"""The answer: each camera's offset and rate, how sure they are, and what a person should know; in JSON and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np

from ...arrays import Float64s
from ...io.plain_values import UnfitValue, entries, items, number, numbers, text
from . import limits
from .pairs import Curve, Source

_LONGEST = 1e7  # seconds: no offset lies beyond
_VERSION = 1
_MOST_CAMERAS = 1000
_MOST_WARNINGS = 10_000
_MOST_LAGS = 100_000
_NAME, _SENTENCE = 1024, 10_000  # characters
_RATES = (0.5, 2.0)
_SOURCES: tuple[str, ...] = get_args(Source)


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
    sources: tuple[str, ...]
    runner_up: RunnerUp | None
    curve: Curve

    def to_json(self) -> dict[str, object]:
        """A plain dictionary; ``from_json`` reads it back."""
        runner_up = self.runner_up
        scores = [None if not np.isfinite(score) else score for score in self.curve.scores.tolist()]
        return {
            "name": self.name,
            "offset": self.offset,
            "rate": self.rate,
            "confidence": self.confidence,
            "sources": list(self.sources),
            "runner_up": None if runner_up is None else {"offset": runner_up.offset, "share": runner_up.share},
            "curve": {"offsets": self.curve.lags.tolist(), "scores": scores},
        }

    @classmethod
    def from_json(cls, data: object) -> CameraClock:
        """The clock of ``to_json``; UnfitValue for anything else."""
        data = dict.fromkeys(("name", "sources", "runner_up", "curve")) | entries(data, "a camera's clock")
        name = text(data["name"], "a camera's name", _NAME)
        of = f"of camera {name}"
        sources = tuple(text(source, f"a source {of}", 20) for source in items(data["sources"], f"sources {of}", 10))
        if unknown := set(sources) - set(_SOURCES):
            raise UnfitValue(f"the source {sorted(unknown)[0]} {of}", f"one of {', '.join(_SOURCES)}")
        runner_up = data["runner_up"]
        if runner_up is not None:
            given = dict.fromkeys(("offset", "share")) | entries(runner_up, f"the runner-up {of}")
            runner_up = RunnerUp(
                number(given["offset"], f"the runner-up's offset {of}", -_LONGEST, _LONGEST),
                number(given["share"], f"the runner-up's share {of}", 0, 1e6),
            )
        return cls(
            name,
            number(data.get("offset"), f"the offset {of}", -_LONGEST, _LONGEST),
            number(data.get("rate", 1.0), f"the rate {of}", *_RATES),
            number(data.get("confidence"), f"the confidence {of}", 0, 1),
            sources,
            runner_up,
            _curve(data["curve"], f"the curve {of}"),
        )


@dataclass(frozen=True, eq=False)
class Synchronization:
    """The clocks of a capture's cameras.

    Attributes:
        cameras: in the order of the films.
        frame: seconds between frames of the slowest film: the unit of "half a frame" below.
        residual: seconds by which the pairs of films miss the clocks (median).
        warnings: sentences for the user.
        refusal: a sentence, where the offsets must not be used; else None.
    """

    cameras: tuple[CameraClock, ...]
    frame: float
    residual: float
    warnings: tuple[str, ...] = ()
    refusal: str | None = None

    @property
    def clocks(self) -> dict[str, tuple[float, float]]:
        """Offset in seconds, and seconds of capture time for each second of film, by camera."""
        return {camera.name: (camera.offset, camera.rate) for camera in self.cameras}

    def to_json(self) -> dict[str, object]:
        """A plain dictionary for a file; ``from_json`` reads it back."""
        return {
            "version": _VERSION,
            "frame": self.frame,
            "residual": self.residual,
            "warnings": list(self.warnings),
            "refusal": self.refusal,
            "cameras": [camera.to_json() for camera in self.cameras],
        }

    @classmethod
    def from_json(cls, data: object) -> Synchronization:
        """The synchronisation of ``to_json``; UnfitValue for anything else."""
        data = dict.fromkeys(("cameras", "warnings", "refusal")) | entries(data, "a synchronisation")
        if data.get("version") != _VERSION:
            raise UnfitValue(f"version {data.get('version')!r} of a synchronisation", f"version {_VERSION}")
        cameras = tuple(CameraClock.from_json(one) for one in items(data["cameras"], "cameras", _MOST_CAMERAS))
        names = [camera.name for camera in cameras]
        if len(set(names)) != len(names):
            raise UnfitValue(f"several clocks of camera {max(names, key=names.count)}", "one of each camera")
        warnings = items(data["warnings"], "warnings", _MOST_WARNINGS)
        refusal = data["refusal"]
        return cls(
            cameras,
            number(data.get("frame"), "the frame interval", 1e-6, 1e4),
            number(data.get("residual"), "the residual", 0, _LONGEST),
            tuple(text(warning, "a warning", _SENTENCE) for warning in warnings),
            None if refusal is None else text(refusal, "the refusal", _SENTENCE),
        )


def _curve(value: object, what: str) -> Curve:
    given = dict.fromkeys(("offsets", "scores")) | entries(value, what)
    scores = items(given["scores"], f"scores in {what}", _MOST_LAGS)
    offsets = numbers(given["offsets"], f"offsets in {what}", (len(scores),), _LONGEST)
    held = [float("nan") if one is None else number(one, f"a score in {what}", -1e6, 1e6) for one in scores]
    result: Float64s = np.array(held, dtype=np.float64)
    return Curve(np.asarray(offsets, dtype=np.float64), result)
