"""From features of standing cameras to their poses and lenses: pairs, hypotheses, adjustment, distortion, evidence."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ...arrays import Float64s, Ints
from .adjustment import Adjusted, adjust
from .evidence import CameraEvidence, PairEvidence, closing_triangles, disagreement, of_cameras, of_pairs
from .features import Features
from .hypotheses import OWN_GAINS, Hypothesis, candidates, gains, propose, rivals, settled
from .lens import Lens
from .matching import match
from .release import Released, released
from .tracks import Pairs, Tracks, join
from .two_view import undistorted_pixels, verified

Progress = Callable[[str, int, int], None]
"""Told a stage's name, and how much of how much is done."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What came of the features; ``verdict`` says whether it is to be believed.

    Attributes:
        adjusted: the model; None where there is none.
        tracks: its observations.
        cameras, pairs: what supports it.
        hypotheses: all starts.
        chosen: the start that it came from.
        rivals: starts that fit as well with other focal lengths, and by what factor.
        coefficients: for each camera how many of k1 and k2 were freed.
        halves_apart: how far cameras lie apart when half of the tracks are used each, over the rig's diameter.
    """

    adjusted: Adjusted | None
    tracks: Tracks
    cameras: tuple[CameraEvidence, ...]
    pairs: tuple[PairEvidence, ...]
    hypotheses: tuple[Hypothesis, ...]
    chosen: Hypothesis | None
    rivals: tuple[tuple[Hypothesis, float], ...]
    coefficients: tuple[int, ...]
    halves_apart: float


def match_all(
    features: Sequence[Features], sizes: Sequence[tuple[int, int]], progress: Progress
) -> tuple[Pairs, Pairs]:
    """The matches of every pair of cameras, and those that pass the two-view check."""
    lenses = [Lens(*size, 1.2 * size[0]) for size in sizes]
    every = list(combinations(range(len(features)), 2))

    def of_pair(pair: tuple[int, int]) -> tuple[Ints, Ints]:
        one, other = pair
        found = match(features[one], features[other])
        return found, verified(lenses[one], features[one].pixels, lenses[other], features[other].pixels, found)

    matches, checked = {}, {}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # numpy and pycolmap compute outside Python's lock
        for place, (pair, (found, good)) in enumerate(zip(every, threads.map(of_pair, every), strict=True)):
            progress("matches", place, len(every))
            matches[pair], checked[pair] = found, good
    return matches, checked


def verified_again(matches: Pairs, pixels: Sequence[Float64s], lenses: Sequence[Lens]) -> Pairs:
    """The matches that pass the two-view check once distortion is known: before, those far off the middle fail it."""
    straight = [undistorted_pixels(lens, own) for lens, own in zip(lenses, pixels, strict=True)]
    return {
        (one, other): verified(lenses[one], straight[one], lenses[other], straight[other], found)
        for (one, other), found in matches.items()
    }


def solve(
    features: Sequence[Features],
    sizes: Sequence[tuple[int, int]],
    groups: Sequence[int],
    pairs: tuple[Pairs, Pairs],
    progress: Progress,
) -> Solution:
    """Poses and lenses of standing cameras.

    Args:
        sizes: width and height in pixels of each camera.
        groups: cameras of one group are of one kind.
        pairs: as of ``match_all``.
    """
    matches, checked = pairs
    pixels = [each.pixels for each in features]
    lenses = [Lens(*size, 1.2 * size[0]) for size in sizes]
    found, few, _ = propose(lenses, groups, pixels, checked, lambda done, all_: progress("poses", done, all_))
    starts = [each for each in candidates(found) if each.adjusted is not None]
    if not starts:
        evidence = tuple(of_pairs(matches, checked, None, few))
        return Solution(None, few, (), evidence, tuple(found), None, (), (0,) * len(sizes), np.inf)
    progress("bundle adjustment", 0, 3)
    freed = [(each, _released(each, few, groups)) for each in starts]
    chosen, best = freed[0]
    for rival, other in freed[1:]:
        if gains(best.costs, other.costs, OWN_GAINS):
            chosen, best = rival, other
    grouping = list(range(len(sizes))) if chosen.own else list(groups)
    model, apart = best.fits[0].model, disagreement(best.fits[0].model, best.fits[1].model)
    progress("bundle adjustment", 1, 3)
    if any(best.coefficients):
        checked = verified_again(matches, pixels, model.lenses)
    tracks = join(checked, pixels)
    adjusted = adjust(model, tracks, grouping, best.coefficients)
    progress("bundle adjustment", 2, 3)
    final = settled(found, few, groups, best.coefficients)
    closing = closing_triangles(adjusted.model.lenses, pixels, checked)
    return Solution(
        adjusted,
        tracks,
        tuple(of_cameras(adjusted, tracks, closing)),
        tuple(of_pairs(matches, checked, adjusted, tracks)),
        tuple(found),
        chosen,
        tuple(rivals(final, final[found.index(chosen)])),
        tuple(best.coefficients),
        apart,
    )


def _released(start: Hypothesis, tracks: Tracks, kinds: Sequence[int]) -> Released:
    """A start with the distortion that held-out tracks ask for."""
    assert start.adjusted is not None
    groups = list(range(len(kinds))) if start.own else list(kinds)
    return released(start.adjusted.model, tracks, groups, kinds)
