"""Several starts of the mapper, compared by one measure over the same observations."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float64s
from .adjustment import Adjusted, adjust
from .evidence import disagreement
from .lens import Lens
from .mapping import Model, incremental
from .tracks import Pairs, Tracks, cost, join, located, summed

STARTS = (0.7, 0.9, 1.2, 1.7)
"""Focal lengths to start from, over the width of the image."""
_PER_CAMERA = 500  # observations that a comparison needs; more of them take longer and change nothing
_PER_PAIR = 40
_SAME_FOCAL, _SAME_PLACES = 0.01, 0.01  # of the focal length and of the rig's diameter
OWN_GAINS = 0.02
"""Share of the cost that focal lengths of their own must save before they are believed: together they drift."""
_CHANCE = 3.0  # standard errors that a gain must exceed: a rig asks up to five such questions, and most must be no


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One start and what became of it.

    Attributes:
        start: focal length over the width.
        own: every camera has a focal length of its own.
        adjusted: the model; None where the mapper found none.
        cost: of the observations of all cameras, 1 for those of a camera without a pose.
    """

    start: float
    own: bool
    adjusted: Adjusted | None
    cost: float

    @property
    def placed(self) -> int:
        """How many cameras have a pose."""
        return 0 if self.adjusted is None else len(self.adjusted.model.placed)

    @property
    def focals(self) -> Float64s:
        """(cameras,) pixels; NaN for those without a pose."""
        if self.adjusted is None:
            return np.empty(0)
        model = self.adjusted.model
        placed = np.isfinite(model.poses).all(axis=(1, 2))
        return np.where(placed, [lens.focal for lens in model.lenses], np.nan)


def thinned(tracks: Tracks, pairs: Pairs, cameras: int) -> tuple[Tracks, dict[tuple[int, int], Bools]]:
    """Enough tracks to compare solutions by, and which matches of each pair belong to them.

    Long tracks come first. Cameras and pairs that see little keep all that they have.
    """
    random = np.random.default_rng(0)
    lengths = np.bincount(tracks.points, minlength=tracks.count)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    seen = np.zeros(cameras, np.int64)
    shared = np.zeros((cameras, cameras), np.int64)
    chosen = np.zeros(tracks.count, bool)
    for point in np.lexsort((random.random(tracks.count), -lengths)).tolist():
        own = tracks.cameras[starts[point] : starts[point + 1]]
        among = np.ix_(own, own)
        if seen[own].min() < _PER_CAMERA or shared[among].min() < _PER_PAIR:
            chosen[point] = True
            seen[own] += 1
            shared[among] += 1
    kept = tracks.chosen(chosen[tracks.points])
    known = [set(kept.features[kept.cameras == camera].tolist()) for camera in range(cameras)]
    masks = {
        (one, other): np.array([a in known[one] and b in known[other] for a, b in matches.tolist()], bool)
        for (one, other), matches in pairs.items()
    }
    return kept, masks


def propose(
    lenses: Sequence[Lens],
    groups: Sequence[int],
    pixels: Sequence[Float64s],
    pairs: Pairs,
    progress: Callable[[int, int], None],
) -> tuple[list[Hypothesis], Tracks, Pairs]:
    """All hypotheses, the tracks that they were compared by, and those tracks' matches.

    Args:
        pairs: verified matches.
        progress: told (done, all) starts.
    """
    tracks, masks = thinned(join(pairs, pixels), pairs, len(lenses))
    few = {pair: pairs[pair][mask] for pair, mask in masks.items() if mask.any()}
    own_groups = list(range(len(lenses)))
    kinds = [(False, list(groups))]
    if len(set(groups)) < len(lenses):
        kinds.append((True, own_groups))
    starts = [(start, own, grouping) for start in STARTS for own, grouping in kinds]

    def mapped(each: tuple[float, bool, list[int]]) -> Model | None:
        start, _, grouping = each
        return incremental(
            [Lens(lens.width, lens.height, start * lens.width) for lens in lenses], grouping, pixels, few
        )

    found: list[Hypothesis] = []
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the mapper works outside Python's lock, on one processor
        for place, ((start, own, grouping), model) in enumerate(zip(starts, threads.map(mapped, starts), strict=True)):
            progress(place, len(starts))
            found.append(_weighed(Hypothesis(start, own, None, 1.0), model, tracks, grouping, found))
    for own, grouping in kinds if len(kinds) > 1 else []:
        found += _carried_over(found, own, grouping, tracks)
    return found, tracks, few


def _carried_over(found: Sequence[Hypothesis], own: bool, groups: Sequence[int], tracks: Tracks) -> list[Hypothesis]:
    """The best hypothesis of the other kind, with this kind's focal lengths.

    The mapper gets lost by chance where data are few: of one kind from all starts, of the other from none.
    """
    best = _best([each for each in found if each.own != own])
    if best is None or best.adjusted is None:
        return []
    model = best.adjusted.model
    focals = np.array([lens.focal for lens in model.lenses])
    placed = np.isin(np.arange(len(focals)), model.placed)
    lenses = []
    for lens, group in zip(model.lenses, groups, strict=True):
        alike = placed & (np.array(groups) == group)
        lenses.append(replace(lens, focal=float(np.median(focals[alike]))) if alike.any() else lens)
    return [_weighed(Hypothesis(best.start, own, None, 1.0), Model(model.poses, tuple(lenses)), tracks, groups, found)]


def _best(found: Sequence[Hypothesis]) -> Hypothesis | None:
    """Of those that place most cameras the one that fits best."""
    models = [each for each in found if each.adjusted is not None]
    return min(models, key=lambda each: (-each.placed, each.cost), default=None)


def _weighed(
    empty: Hypothesis, model: Model | None, tracks: Tracks, groups: Sequence[int], others: Sequence[Hypothesis]
) -> Hypothesis:
    """A start with its adjusted model, or that of another start which the mapper led to the same place."""
    if model is None or len(model.placed) < 2 or not _is_possible(model):
        return empty
    for other in others:
        if other.own == empty.own and other.adjusted is not None and _same(model, other.adjusted.model):
            return replace(other, start=empty.start)
    adjusted = adjust(model, tracks, groups, [0] * len(groups))
    if not _is_possible(adjusted.model):
        return empty
    return replace(empty, adjusted=adjusted, cost=whole_cost(adjusted.distances, tracks, adjusted.model.lenses))


def _is_possible(model: Model) -> bool:
    """Whether focal lengths are above zero, which adjustment does not see to."""
    return all(model.lenses[camera].focal > 0 for camera in model.placed)


def _same(one: Model, other: Model) -> bool:
    """Equal but for what another adjustment would settle."""
    focals = np.array([[a.focal, b.focal] for a, b in zip(one.lenses, other.lenses, strict=True)])[one.placed]
    return (
        one.placed == other.placed
        and bool(np.abs(np.log(focals[:, 0] / focals[:, 1])).max() < _SAME_FOCAL)
        and disagreement(one, other) < _SAME_PLACES
    )


def whole_cost(distances: Float64s, tracks: Tracks, lenses: Sequence[Lens]) -> float:
    """Truncated squared residuals of all observations, in units of each camera's limit."""
    limits = np.array([lens.limit for lens in lenses])
    return cost(distances, limits[tracks.cameras])


def held_out_costs(adjusted: Adjusted, tracks: Tracks, counted: Bools) -> Float64s:
    """(count,) the cost of each track that the model was not adjusted to: only its point is fitted.

    Args:
        counted: (cameras,) whose observations are summed.
    """
    model = adjusted.model
    limits = np.array([lens.limit for lens in model.lenses])
    _, distances = located(tracks, model.poses, model.lenses, limits)
    costs = np.minimum(distances / limits[tracks.cameras], 1.0) ** 2
    return summed(costs * counted[tracks.cameras], tracks)


def gains(before: Float64s, after: Float64s, least: float) -> bool:
    """Whether the costs of the same tracks (count,) fell by that share of their sum, and by more than by chance.

    A paired test: with few tracks one false match that happens to fit would decide otherwise.
    """
    fell = before - after
    chance = _CHANCE * np.sqrt(len(fell)) * fell.std() if len(fell) else 0.0
    return bool(fell.sum() > max(least * before.sum(), chance))


def halves(tracks: Tracks) -> tuple[Tracks, Tracks]:
    """The tracks in two halves, at random."""
    first = np.random.default_rng(1).random(tracks.count) < 0.5
    return tracks.chosen(first[tracks.points]), tracks.chosen(~first[tracks.points])


def candidates(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The best hypothesis of one focal length a group; and the best of own ones, where those gain much.

    Both place as many cameras as any. Own focal lengths imitate lens distortion, so that a choice between the two must
    wait for it.
    """
    models = [each for each in hypotheses if each.adjusted is not None]
    most = max((each.placed for each in models), default=0)
    models = [each for each in models if each.placed == most]
    shared = min((each for each in models if not each.own), key=lambda each: each.cost, default=None)
    own = min((each for each in models if each.own), key=lambda each: each.cost, default=None)
    if shared is not None and own is not None and own.cost * (1 + OWN_GAINS) > shared.cost:
        own = None
    return [each for each in (shared, own) if each is not None]


def settled(
    hypotheses: Sequence[Hypothesis], tracks: Tracks, kinds: Sequence[int], coefficients: Sequence[int]
) -> list[Hypothesis]:
    """The hypotheses with that many of k1 and k2 free for each camera: without, wrong focal lengths imitate them."""
    if not any(coefficients):
        return list(hypotheses)
    found: list[Hypothesis] = []
    for each in hypotheses:
        if each.adjusted is None or not each.adjusted.model.placed:
            found.append(each)
            continue
        same = [i for i, other in enumerate(hypotheses[: len(found)]) if other.adjusted is each.adjusted]
        if same:  # two starts that led to one place
            found.append(replace(found[same[0]], start=each.start))
            continue
        groups = list(range(len(kinds))) if each.own else kinds
        again = adjust(each.adjusted.model, tracks, groups, coefficients)
        weighed = whole_cost(again.distances, tracks, again.model.lenses)
        found.append(replace(each, adjusted=again, cost=weighed))
    return found


def rivals(hypotheses: Sequence[Hypothesis], chosen: Hypothesis) -> list[tuple[Hypothesis, float]]:
    """Hypotheses that fit the images as well, within 5 % of the cost, with other focal lengths: by what factor."""
    found = []
    for each in hypotheses:
        if each is chosen or each.adjusted is None or each.cost > 1.05 * chosen.cost:
            continue
        ratio = np.nanmedian(each.focals / chosen.focals) if len(each.focals) else np.nan
        if np.isfinite(ratio) and abs(np.log(ratio)) > 0.03:
            found.append((each, float(ratio)))
    return found
