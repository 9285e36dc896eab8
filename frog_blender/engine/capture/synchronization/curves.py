"""The score of a camera's offset, all other cameras held: a curve for a person to look at, and to correct by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import ImageArray
from ..video import load_opencv
from .pair import Curve, PairLag, maxima, no_curve
from .solve import Clocks
from .synchronization import RunnerUp, Synchronization

_ROW, _LEFT = 96, 130  # pixels of a drawn curve's height and of its caption
_INK, _LINE, _CHOSEN, _OTHER = (40, 40, 40), (60, 110, 190), (30, 150, 70), (200, 120, 40)


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
            place = (6, top + 24 + 24 * line)
            cv2.putText(image, caption, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
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
