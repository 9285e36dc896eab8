"""From solved clocks to the answer a user gets: curves, confidence, runner-up, warnings, and when to refuse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import ImageArray
from ..video import load_opencv
from . import limits
from .films import Film
from .pairs import Clocks, Curve, PairLag, Solution, maxima, no_curve
from .synchronization import CameraClock, RunnerUp, Synchronization

_ROW, _LEFT = 96, 130  # pixels of a drawn curve's height and of its caption
_INK, _LINE, _CHOSEN, _OTHER = (40, 40, 40), (60, 110, 190), (30, 150, 70), (200, 120, 40)


def reported(films: Sequence[Film], solution: Solution, pairs: Sequence[PairLag]) -> Synchronization:
    """The clocks of films as the user sees them; ``pairs`` are the lags that they were solved from."""
    frame = max(film.interval for film in films) if films else 1.0
    clocks, cameras = solution.clocks, []
    for index, film in enumerate(films):
        curve, offset = camera_curve(index, pairs, clocks, frame), float(clocks.offsets[index])
        own = [number for number, pair in enumerate(pairs) if index in (pair.first, pair.second)]
        sources = tuple(sorted({pairs[number].source for number in own}))
        confidence = 1.0 if len(films) == 1 else _confidence(index, solution, [pairs[number] for number in own])
        runner = runner_up(curve, offset, frame)
        cameras.append(CameraClock(film.name, offset, float(clocks.rates[index]), confidence, sources, runner, curve))
    warnings = [sentence for camera in cameras for sentence in _doubts(camera, frame)]
    warnings += _coarse_sentence(cameras)
    residual = float(np.median(np.abs(solution.misses))) if len(solution.misses) else 0.0
    refusal = _refusal(films, solution, cameras)
    return Synchronization(tuple(cameras), frame, residual, tuple(warnings), refusal)


def _confidence(film: int, solution: Solution, pairs: Sequence[PairLag]) -> float:
    """0 to 1: the share of a film's pairs that agree, times how well they do, less where no triangle checks them."""
    if not pairs:
        return 0.0
    is_open = solution.open_triangles[film]
    checked = 1.0 if len(solution.support) == 2 else 0.5 if np.isnan(is_open) else 1 - float(is_open)
    if {pair.source for pair in pairs} == {"energy"}:
        checked *= limits.ENERGY_TRUST  # views that see motion unlike each other may agree on a wrong lag
    # A third of the moving matches on their epipolar lines is as good as it gets where things hide each other.
    agreement = min(1.0, 2.5 * float(np.median([pair.score for pair in pairs])))
    return float(np.clip(solution.support[film] * np.sqrt(checked) * agreement, 0, 1))


def _doubts(camera: CameraClock, frame: float) -> list[str]:
    """What the user should know about one camera."""
    sentences = []
    if camera.confidence < limits.UNSURE:
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
    coarse = [camera.name for camera in cameras if camera.sources and set(camera.sources) <= {"energy"}]
    if not coarse:
        return []
    which = ", ".join(coarse) if len(coarse) < len(cameras) else "all cameras"
    return [f"The offsets of {which} come from the amount of motion alone and may be a frame wrong."]


def _refusal(films: Sequence[Film], solution: Solution, cameras: Sequence[CameraClock]) -> str | None:
    """Why the offsets must not be used, and what to do; None if they may."""
    if len(films) < 2:
        return None
    lost = [film.name for i, film in enumerate(films) if not solution.connected[i]]
    if lost:
        return (
            f"Camera {lost[0]} shares neither sound nor motion with another: clap once where all cameras see and hear "
            "it, or type its offset."
        )
    unsure = [camera.name for camera in cameras if camera.confidence < limits.LEAST_CONFIDENCE]
    if unsure:
        return (
            f"The films' lags contradict each other for camera {', '.join(unsure)}: clap once where all cameras see "
            "and hear it, or type the offset."
        )
    return None


def camera_curve(film: int, pairs: Sequence[PairLag], clocks: Clocks, frame: float) -> Curve:
    """The mean of a film's pair curves over its offset, seconds; each weighs by its score.

    Args:
        film: index of the film.
        pairs: of all films, with curves.
        clocks: the answer.
        frame: seconds between frames.
    """
    shifted: list[tuple[Curve, float]] = []
    for pair in pairs:
        if film not in (pair.first, pair.second) or not len(pair.curve.lags):
            continue
        # A greater offset of the second film is a greater lag; of the first, a smaller one.
        sign = 1.0 if film == pair.second else -1.0
        moved = sign * (pair.curve.lags - clocks.lag(pair.first, pair.second, pair.at))
        order = np.argsort(moved)
        shifted.append((Curve(moved[order], pair.curve.scores[order]), max(pair.score, 1e-3)))
    if not shifted:
        return no_curve()
    low, high = min(curve.lags[0] for curve, _ in shifted), max(curve.lags[-1] for curve, _ in shifted)
    step = 0.25 * frame
    grid = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    total, weights = np.zeros(len(grid)), np.zeros(len(grid))
    for curve, weight in shifted:
        known = np.isfinite(curve.scores)
        if known.sum() < 2:
            continue
        values = np.interp(grid, curve.lags[known], curve.scores[known], left=np.nan, right=np.nan)
        inside = np.isfinite(values)
        total[inside] += weight * values[inside]
        weights[inside] += weight
    # Where few pairs overlap, chance decides.
    enough = weights >= 0.5 * weights.max() if len(weights) else weights > 0
    scores = np.where(enough, total / np.maximum(weights, 1e-12), np.nan)
    return Curve(grid + clocks.offsets[film], scores)


def runner_up(curve: Curve, offset: float, frame: float) -> RunnerUp | None:
    """The best maximum of a camera's curve at least a frame from its offset, seconds."""
    known = np.isfinite(curve.scores)
    if known.sum() < 3:
        return None
    best = float(np.interp(offset, curve.lags[known], curve.scores[known]))
    for lag, score in maxima(curve, frame, most=8):
        if abs(lag - offset) > frame and score > 0 and best > 0:
            return RunnerUp(lag, score / best)
    return None


def draw_curves(result: Synchronization, width: int = 900) -> ImageArray:
    """(H, W, 3) uint8 RGB: a row a camera, its chosen offset in green, a runner-up as likely in orange."""
    cv2 = load_opencv()
    image = np.full((_ROW * max(len(result.cameras), 1), width, 3), 255, np.uint8)
    for row, camera in enumerate(result.cameras):
        top = row * _ROW
        cv2.line(image, (0, top + _ROW - 1), (width, top + _ROW - 1), (220, 220, 220), 1)
        captions = (camera.name[:16], f"{camera.offset:+.4f} s", f"confidence {camera.confidence:.2f}")
        for line, caption in enumerate(captions):
            corner = (6, top + 24 + 24 * line)
            cv2.putText(image, caption, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
        known = np.isfinite(camera.curve.scores)
        if known.sum() < 2:
            continue
        lags, scores = camera.curve.lags[known], camera.curve.scores[known]
        low, high = float(lags[0]), float(lags[-1])
        bottom, peak = min(0.0, float(scores.min())), max(float(scores.max()), 1e-6)

        def column(lag: float, low: float = low, high: float = high) -> int:
            return _LEFT + round((width - _LEFT - 8) * float(np.clip((lag - low) / max(high - low, 1e-9), 0, 1)))

        if camera.runner_up is not None and camera.runner_up.is_as_likely:
            x = column(camera.runner_up.offset)
            cv2.line(image, (x, top + 4), (x, top + _ROW - 6), _OTHER, 1)
        x = column(camera.offset)
        cv2.line(image, (x, top + 4), (x, top + _ROW - 6), _CHOSEN, 2)
        heights = top + _ROW - 6 - (_ROW - 12) * (scores - bottom) / (peak - bottom)
        points = np.stack([[column(float(lag)) for lag in lags], heights.round()], axis=1).astype(np.int32)
        cv2.polylines(image, [points[:, None]], False, _LINE, 1, cv2.LINE_AA)
    return image
