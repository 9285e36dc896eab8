"""Left for right: the pose network's commonest mistake, seen from the side or from behind, undone.

It lasts for many images, in which both sides change their names together. A film alone shows where it begins and ends,
for the joints jump to each other's places; the other cameras show which of two names is right.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..synchronization.epipolar import signed_residuals

_JUMP = 0.5  # of the person's half height: a joint that goes farther between two images costs no more
_DOUBT = 0.02  # of a jump of all joints: what it costs to contradict the network in one image
_LEAST_DOUBT = 0.02  # the same in all images together: it decides between two ways on which the joints go as far
_SURER = 0.8  # of the cost as it was: a change of sides must gain so much
_MOST_TOGETHER = 6  # cameras of which all combinations are tried; more are tried one by one


def other_side(count: int) -> Ints:
    """(count,) each joint's fellow on the other side, of joints that come in pairs of left and right."""
    return np.arange(count) ^ 1


def readings_of_sides(pixels: Float64s) -> list[Bools]:
    """(T,) in which images of a film left and right must change places, in one or two ways, the likelier one first.

    Seen from the side both names of a joint lie in almost one place, and nothing in the film tells whether they changed
    there. The first way trusts the network, which is right in most images; the second one the places alone.

    Args:
        pixels: (T, J, 2) joints in pairs of left and right; NaN where none is seen.
    """
    trusting = steady_sides(pixels)
    seen = np.isfinite(pixels[:, :, 0]).any(1)
    distrusting = steady_sides(pixels, _LEAST_DOUBT / max(int(seen.sum()), 1))
    differ = (trusting != distrusting)[seen]
    return [trusting] if differ.all() or not differ.any() else [trusting, distrusting]


def steady_sides(pixels: Float64s, doubt: float = _DOUBT) -> Bools:
    """(T,) in which images of a film left and right must change places for the joints not to jump.

    Args:
        pixels: (T, J, 2) joints in pairs of left and right; NaN where none is seen.
        doubt: of a jump of all joints, what it costs to contradict the network in one image.
    """
    seen = np.flatnonzero(np.isfinite(pixels[:, :, 0]).any(1))
    swapped = np.zeros(len(pixels), dtype=bool)
    if len(seen) < 2:
        return swapped
    places = pixels[seen]
    size = _JUMP * float(np.nanmedian(np.nanmax(places[:, :, 1], axis=1) - np.nanmin(places[:, :, 1], axis=1))) / 2
    fellow = other_side(pixels.shape[1])
    stays = _moved(places[:-1], places[1:], size)
    jumps = _moved(places[:-1], places[1:][:, fellow], size)
    # The cheapest way through the images (Viterbi), of the two names that each may have.
    costs, came_from = np.array([0.0, doubt]), []
    for stay, jump in zip(stays.tolist(), jumps.tolist(), strict=True):
        ways = costs[:, None] + np.array([[stay, jump], [jump, stay]])
        came_from.append(ways.argmin(0))
        costs = ways.min(0) + np.array([0.0, doubt])
    state = int(costs.argmin())
    for place in range(len(seen) - 1, -1, -1):
        swapped[seen[place]] = state == 1
        if place:
            state = int(came_from[place - 1][state])
    return swapped


def _moved(before: Float64s, after: Float64s, size: float) -> Float64s:
    """(T,) how far joints went, as a mean of parts of ``size``, of those that both images show."""
    gone = np.minimum(np.linalg.norm(after - before, axis=2) / max(size, 1e-9), 1.0)
    counts = np.isfinite(gone).sum(1)
    found: Float64s = np.nansum(gone, axis=1) / np.maximum(counts, 1)
    return found


def agreed_sides(pixels: Float64s, matrices: Mapping[tuple[int, int], Float64s], limit: float) -> Bools:
    """(C, T) in which images left and right must change places for the cameras to agree.

    Args:
        pixels: (C, T, J, 2) joints of all cameras at the same times, in pairs of left and right; NaN where not seen.
        matrices: (3, 3) fundamental matrices of the pairs of cameras.
        limit: pixels beyond which a joint is false.
    """
    cameras, times = pixels.shape[:2]
    straight, crossed = np.zeros((cameras, cameras, times)), np.zeros((cameras, cameras, times))
    fellow = other_side(pixels.shape[2])
    for (one, other), matrix in matrices.items():
        for costs, second in ((straight, pixels[other]), (crossed, pixels[other][:, fellow])):
            flat = signed_residuals(matrix, pixels[one].reshape(-1, 2), second.reshape(-1, 2))
            each = np.minimum((flat.reshape(times, -1) / limit) ** 2, 1.0)
            costs[one, other] = costs[other, one] = np.nansum(each, axis=1)
    best = np.zeros((cameras, times), dtype=bool)
    first = least = _cost(best, straight, crossed)
    for labels in _labels(cameras):
        for base in (np.zeros((cameras, times), dtype=bool), best):
            tried = base ^ labels[:, None]
            cost = _cost(tried, straight, crossed)
            is_better = (cost < _SURER * first) & (cost < least - 1e-9)
            best = np.where(is_better, tried, best)
            least = np.where(is_better, cost, least)
    # All cameras at once is the same as none: the fewer contradict the network, the better.
    return np.asarray(np.where(2 * best.sum(0) > cameras, ~best, best))


def _labels(cameras: int) -> list[Bools]:
    if cameras > _MOST_TOGETHER:
        return list(np.eye(cameras, dtype=bool))
    return [np.array([False, *chosen]) for chosen in product((False, True), repeat=cameras - 1)]


def _cost(swapped: Bools, straight: Float64s, crossed: Float64s) -> Float64s:
    """(T,) of all pairs of cameras."""
    found: Float64s = np.where(swapped[:, None] != swapped[None], crossed, straight).sum((0, 1))
    return found
