"""From solved clocks to the answer a user gets: confidence, runner-up, warnings, and when to refuse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .curves import camera_curve, runner_up
from .pair import PairLag
from .recordings import Recording
from .solve import Solution
from .synchronization import CameraClock, RunnerUp, Synchronization

_OPEN = 0.5  # share of a film's triangles that may fail to close
_UNSURE = 0.5  # of confidence below which the user is told
_LEAST = 0.1  # of confidence below which offsets are not to be used
_TRUSTED = 0.5  # of energy alone
_COARSE = ("energy",)  # alone, good for a start only


def reported(
    films: Sequence[Recording],
    solution: Solution,
    pairs: Sequence[PairLag],
    rivals: Mapping[int, RunnerUp] | None = None,
) -> Synchronization:
    """The clocks as the user sees them.

    Args:
        films: all of them.
        solution: their clocks.
        pairs: the lags that it was solved from.
        rivals: of films, offsets that lie beyond the curves.
    """
    rivals = rivals or {}
    frame = max(film.interval for film in films) if films else 1.0
    clocks, cameras = solution.clocks, []
    for number, film in enumerate(films):
        curve = camera_curve(number, pairs, clocks, frame)
        offset = float(clocks.offsets[number])
        cameras.append(
            CameraClock(
                name=film.name,
                offset=offset,
                rate=float(clocks.rates[number]),
                confidence=1.0 if len(films) == 1 else _confidence(number, solution, pairs),
                sources=tuple(sorted({pair.source for pair in pairs if number in (pair.first, pair.second)})),
                runner_up=_better(runner_up(curve, offset, frame), rivals.get(number)),
                curve=curve,
            )
        )
    warnings = [sentence for camera in cameras for sentence in _doubts(camera, frame)]
    warnings += _coarse_sentence(cameras)
    warnings += _open_sentences(films, solution)
    residual = float(np.median(np.abs(solution.misses))) if len(solution.misses) else 0.0
    refusal = _refusal(films, solution, cameras)
    return Synchronization(tuple(cameras), frame, residual, tuple(warnings), refusal, tuple(pairs))


def _better(first: RunnerUp | None, second: RunnerUp | None) -> RunnerUp | None:
    found = [one for one in (first, second) if one is not None]
    return max(found, key=lambda one: one.share) if found else None


def _confidence(film: int, solution: Solution, pairs: Sequence[PairLag]) -> float:
    """0 to 1: the share of a film's pairs that agree, times how well they do, less where no triangle checks them."""
    scores = [
        pair.score
        for pair, miss in zip(pairs, solution.misses, strict=True)
        if film in (pair.first, pair.second) and np.isfinite(miss)
    ]
    if not scores:
        return 0.0
    is_open = solution.open_triangles[film]
    checked = 1.0 if len(solution.support) == 2 else 0.5 if np.isnan(is_open) else 1 - float(is_open)
    if {pair.source for pair in pairs if film in (pair.first, pair.second)} <= set(_COARSE):
        checked *= _TRUSTED  # views that see motion unlike each other may agree on a wrong lag
    # A third of the moving matches on their epipolar lines is as good as it gets where things hide each other.
    agreement = min(1.0, 2.5 * float(np.median(scores)))
    return float(np.clip(solution.support[film] * np.sqrt(checked) * agreement, 0, 1))


def _doubts(camera: CameraClock, frame: float) -> list[str]:
    """What the user should know about one camera."""
    sentences = []
    if camera.confidence < _UNSURE:
        sentences.append(
            f"Camera {camera.name}: its offset of {camera.offset:.3f} s is uncertain "
            f"(confidence {camera.confidence:.2f}); look at its curve, or type the offset."
        )
    rival = camera.runner_up
    if rival is not None and rival.is_as_likely and abs(rival.offset - camera.offset) > frame:
        sentences.append(
            f"Camera {camera.name}: an offset of {rival.offset:.3f} s fits nearly as well as {camera.offset:.3f} s; "
            "does the motion repeat itself?"
        )
    return sentences


def _coarse_sentence(cameras: Sequence[CameraClock]) -> list[str]:
    coarse = [camera.name for camera in cameras if camera.sources and set(camera.sources) <= set(_COARSE)]
    if not coarse:
        return []
    which = ", ".join(coarse) if len(coarse) < len(cameras) else "all cameras"
    return [f"The offsets of {which} come from the amount of motion alone and may be a frame wrong."]


def _open_sentences(films: Sequence[Recording], solution: Solution) -> list[str]:
    return [
        f"Camera {film.name}: the lags between it and two others do not add up within half a frame "
        f"in {100 * share:.0f} % of the cases."
        for film, share in zip(films, solution.open_triangles.tolist(), strict=True)
        if share > _OPEN
    ]


def _refusal(films: Sequence[Recording], solution: Solution, cameras: Sequence[CameraClock]) -> str | None:
    """Why the offsets must not be used, and what to do; None if they may."""
    if len(films) < 2:
        return None
    lost = [film.name for i, film in enumerate(films) if not solution.connected[i]]
    if lost:
        return (
            f"Camera {lost[0]} shares neither sound nor motion with another: clap once where all cameras see and hear "
            "it, or type its offset."
        )
    unsure = [camera.name for camera in cameras if camera.confidence < _LEAST]
    if unsure:
        return (
            f"The films' lags contradict each other for camera {', '.join(unsure)}: clap once where all cameras see "
            "and hear it, or type the offset."
        )
    return None
