"""Whether something large moves before moving cameras: matches of near images that contradict their poses together.

A fundamental matrix follows whatever has most features. Where a large subject has them, poses are relative to it, or to
neither, and fit all the same: their residuals, costs and halves look as they do where nothing moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from ..epipolar import fundamental, sampson_distances
from .features import Features
from .mapping import Model
from .matching import match
from .two_view import LEAST_MATCHES, undistorted_pixels, verified
from .walk import Tell, Walk

_GAPS = (1, 2)  # images between two that are compared: farther ones share too little to tell motion from false matches
_MOST_PAIRS = 120
_COHERENT = 0.5  # of the matches that contradict: a false geometry takes a quarter of false matches
_MOVES = 0.08  # of the matches


def moving_share(walks: Sequence[Walk], features: Sequence[Features], model: Model, tell: Tell) -> float:
    """Median share of the matches of two near images that contradict the cameras' poses, and do so in one way.

    Args:
        features: of each image, walk by walk.
    """
    placed = set(model.placed)
    pairs = [pair for pair in _near(walks) if placed.issuperset(pair)]
    pairs = pairs[:: max(1, ceil(len(pairs) / _MOST_PAIRS))]
    shares = []
    for place, (one, other) in enumerate(pairs):
        tell("what moves", place, len(pairs))
        found = match(features[one], features[other])
        if len(found) < LEAST_MATCHES:
            continue
        lenses = model.lenses[one], model.lenses[other]
        matrix = fundamental(
            *(lens.camera("", model.poses[index]) for lens, index in zip(lenses, (one, other), strict=True))
        )
        pixels = [undistorted_pixels(model.lenses[each], features[each].pixels) for each in (one, other)]
        missed = sampson_distances(matrix, pixels[0][found[:, 0]], pixels[1][found[:, 1]])
        rest = found[np.abs(missed) > max(lens.limit for lens in lenses)]
        together = verified(lenses[0], pixels[0], lenses[1], pixels[1], rest)
        is_motion = len(together) >= _COHERENT * len(rest)
        shares.append(len(together) / len(found) if is_motion else 0.0)
    return float(np.median(shares)) if shares else 0.0


def doubts(share: float) -> list[str]:
    """What to tell about matches of which that share moves."""
    if share <= _MOVES:
        return []
    return [
        f"{100 * share:.0f} % of the matches between neighbouring images move otherwise than the rest: something large "
        "moves, and the camera's path may be wrong, or relative to it. Look at the result; next time let more of what "
        "rests be seen around it."
    ]


def _near(walks: Sequence[Walk]) -> list[tuple[int, int]]:
    """Pairs of images of one camera, in order."""
    pairs, start = [], 0
    for walk in walks:
        end = start + len(walk.images)
        pairs += [(one, one + gap) for one in range(start, end) for gap in _GAPS if one + gap < end]
        start = end
    return pairs
