"""Two views of known cameras: do matching points lie on each other's epipolar lines, and when do moving ones?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..epipolar import fundamental, line_distances
from ..video import load_opencv
from .samples import Sample

_RATIO = 0.8  # best to second best descriptor distance
_RANSAC_PIXELS = 1.5
_ENOUGH = 20  # matches on which a fundamental matrix agrees
_ENOUGH_MOVING = 10
_NEAR = 0.02  # of the longest side: matches of moving points farther from their lines are wrong
_CROSSING = 0.25  # pixels a frame, across the epipolar line: slower points say nothing about time
_CHANGE = 6.0  # of 255, from one frame to the next: motion
_CERTAIN = 0.12  # frames
_SHARE = 0.3  # of the matches, that a fundamental matrix must explain


@dataclass(frozen=True)
class PairCheck:
    """Two views of the same frame, or of a moving camera.

    Attributes:
        matches: points on which a fundamental matrix of their own agrees, whatever the calibration says.
        distance: their median distance in pixels of the capture's images from the epipolar lines of the calibration;
            None for too few of them.
        offset: frames by which the second camera shows what moves later than the first does; None where too little
            moves.
        gain: brightness of the second over the first; None for too few matches.
    """

    matches: int
    distance: float | None
    offset: float | None
    gain: float | None


def check_pair(first: Sample, second: Sample) -> PairCheck:
    """What matching features say about two views."""
    a, b = _match(first, second)
    matrix = fundamental(first.camera, second.camera)
    agreeing = _agreeing(first.positions[a], second.positions[b])
    if agreeing.sum() < _ENOUGH or agreeing.mean() < _SHARE:
        return PairCheck(int(agreeing.sum()), None, None, None)
    matched = a, b
    a, b = a[agreeing], b[agreeing]
    still = ~(_is_moving(first, first.positions[a]) | _is_moving(second, second.positions[b]))
    if still.sum() >= _ENOUGH:
        a, b = a[still], b[still]
    to_b, to_a = line_distances(matrix, first.positions[a], second.positions[b])
    apart = float(np.median((np.abs(to_b) * second.scale + np.abs(to_a) * first.scale) / 2))
    offset = _offset(first, second, matched, matrix, apart / second.scale)
    return PairCheck(len(a), apart, offset, _gain(first.colors[a], second.colors[b]))


def _match(first: Sample, second: Sample) -> tuple[Ints, Ints]:
    """Indices of features that are each other's best, and better than the second best by far."""
    empty = np.zeros(0, dtype=np.int64)
    if min(len(first.positions), len(second.positions)) < 2:
        return empty, empty
    similarity = first.descriptors @ second.descriptors.T
    rows, best = np.arange(len(similarity)), similarity.argmax(axis=1)
    back = similarity.argmax(axis=0)
    score = similarity[rows, best]
    similarity[rows, best] = -1.0
    apart, next_apart = (np.sqrt(np.maximum(2 - 2 * each, 0)) for each in (score, similarity.max(axis=1)))
    keep = (back[best] == rows) & (apart < _RATIO * next_apart)
    return rows[keep], best[keep]


def _agreeing(a: Float64s, b: Float64s) -> Bools:
    """Which of the matches (N, 2) a fundamental matrix found from them explains."""
    nothing = np.zeros(len(a), dtype=bool)
    if len(a) < _ENOUGH:
        return nothing
    cv2 = load_opencv()
    cv2.setRNGSeed(0)
    _, mask = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, _RANSAC_PIXELS, 0.999, 5000)
    return nothing if mask is None else np.asarray(mask).ravel().astype(bool)


def _is_moving(sample: Sample, positions: Float64s) -> Bools:
    """Where the image changes until the next frame."""
    if sample.following is None:
        return np.zeros(len(positions), dtype=bool)
    cv2 = load_opencv()
    change = cv2.blur(cv2.absdiff(sample.gray, sample.following), (9, 9))
    columns, lines = np.clip(positions.astype(int), 0, [sample.camera.width - 1, sample.camera.height - 1]).T
    moving: Bools = change[lines, columns] > _CHANGE
    return moving


def _offset(first: Sample, second: Sample, matched: tuple[Ints, Ints], matrix: Float64s, wrong: float) -> float | None:
    """By how many frames the second camera is late, from how moving points cross their epipolar lines.

    Args:
        wrong: pixels by which points that stand still are off: what the calibration may feign.
    """
    if second.following is None:
        return None
    a, b = matched
    at_a, at_b = first.positions[a], second.positions[b]
    moving = _is_moving(first, at_a) & _is_moving(second, at_b)
    apart = np.abs(line_distances(matrix, at_a, at_b)[0])
    near = moving & (apart < _NEAR * max(second.gray.shape))
    if near.sum() < _ENOUGH_MOVING:
        return None
    at_a, at_b = at_a[near], at_b[near]
    cv2 = load_opencv()
    start = (at_b - 0.5).astype(np.float32)[:, None]
    tracked, found, _ = cv2.calcOpticalFlowPyrLK(second.gray, second.following, start, None)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(second.following, second.gray, tracked, None)
    sure = (found.ravel() > 0) & (found_back.ravel() > 0) & (np.linalg.norm(back - start, axis=2).ravel() < 0.5)
    now = line_distances(matrix, at_a, at_b)[0]
    then = line_distances(matrix, at_a, tracked[:, 0].astype(np.float64) + 0.5)[0]
    crossing = then - now
    sure &= np.abs(crossing) > _CROSSING
    if sure.sum() < _ENOUGH_MOVING:
        return None
    late, weights = -now[sure] / crossing[sure], np.abs(crossing[sure])
    middle = _weighted_median(late, weights)
    doubt = 1.5 * _weighted_median(np.abs(late - middle), weights) / np.sqrt(sure.sum())
    doubt = max(doubt, 0.5 * wrong / float(np.median(weights)))
    return middle if doubt < _CERTAIN else None


def _weighted_median(values: Float64s, weights: Float64s) -> float:
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, summed[-1] / 2)])


def _gain(first: Float64s, second: Float64s) -> float | None:
    """Median ratio of the brightness around the matches, of those that are neither dark nor clipped."""
    light_a, light_b = first.mean(axis=1), second.mean(axis=1)
    usable = (np.minimum(light_a, light_b) > 12) & (np.maximum(first, second).max(axis=1) < 240)
    if usable.sum() < _ENOUGH:
        return None
    return float(np.exp(np.median(np.log(light_b[usable] / light_a[usable]))))
