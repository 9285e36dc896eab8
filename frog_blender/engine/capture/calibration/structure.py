"""Structure from motion: matches between images to poses, lenses and points, from several focal lengths.

Every start of the mapper is compared by one measure over the same observations, and whatever frees a parameter must
lower the cost of tracks that the model was not adjusted to.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Float64s
from ...io.child_process import Progress
from . import limits
from .colmap import Adjusted, adjust, incremental, verified_again
from .model import Lens, Model, Pairs, Tracks, disagreement, located, summed, tracks_of

STARTS = (0.7, 0.9, 1.2, 1.7)
"""Focal lengths to start from, over the width of the image."""
_FEW_STARTS = (0.9, 1.3)
_MANY_IMAGES = 40  # from which on the mapper is asked less often
_PER_IMAGE = 500  # observations that a comparison needs; more of them take longer and change nothing
_PER_PAIR = 40
_SAME_FOCAL, _SAME_PLACES = 0.01, 0.01  # of the focal length and of the images' diameter


@dataclass(frozen=True, eq=False)
class Images:
    """What structure from motion knows of images before it places them: standing cameras, then those that move.

    Attributes:
        lenses: sizes; focal lengths are not known.
        groups: images of one group are of one kind of camera.
        pixels: (N, 2) of the features of each.
        standing: how many stand, each of which may be given a focal length of its own.
    """

    lenses: tuple[Lens, ...]
    groups: tuple[int, ...]
    pixels: tuple[Float64s, ...]
    standing: int

    @property
    def connected(self) -> bool:
        """Images of a walk-through connect the standing cameras, which need not see the same things."""
        return len(self.lenses) > self.standing

    def sharing(self, *, own: bool) -> list[int]:
        """By image: those of one number share their focal length; with ``own`` each standing camera has one alone."""
        first = 1 + max(self.groups)
        alone = list(range(first, first + self.standing)) if own else list(self.groups[: self.standing])
        return [*alone, *self.groups[self.standing :]]


@dataclass(frozen=True, eq=False)
class Solution:
    """What came of the images; ``checks`` say whether it is to be used.

    Attributes:
        adjusted: the model, which may place nothing.
        verified: the matches that its tracks join.
        halves_apart: how far images lie apart when half of the tracks are used each, over the rig's or path's size.
    """

    adjusted: Adjusted
    verified: Pairs
    halves_apart: float = np.inf


@dataclass(frozen=True, eq=False)
class _Distorted:
    """A model with the coefficients that held-out tracks ask for.

    Attributes:
        fits: the model adjusted to each half of the tracks.
        coefficients: for each image how many of k1 and k2 are free.
        costs: (count,) of all tracks, each when it was held out.
    """

    fits: tuple[Adjusted, Adjusted]
    coefficients: list[int]
    costs: Float64s


def solve(images: Images, matches: Pairs, verified: Pairs, tell: Progress) -> Solution:
    """Poses and lenses of the images.

    Args:
        matches, verified: as of ``matching.match_pairs``.
        tell: told a stage's name, and how much of how much is done.
    """
    tracks, few = _thinned(tracks_of(verified, images.pixels), verified, len(images.lenses))
    starts = _candidates(propose(images, tracks, few, tell))
    if not starts:
        nowhere = Model(np.full((len(images.lenses), 3, 4), np.nan), images.lenses)
        return Solution(adjust(nowhere, tracks, images.groups, [0] * len(images.lenses)), verified)
    tell("bundle adjustment", 0, 2)
    fitted = [(own, _with_distortion(start.model, own, tracks, images)) for own, start in starts.items()]
    has_own, best = fitted[0]
    for own, rival in fitted[1:]:
        if gains(best.costs, rival.costs, limits.OWN_GAINS):
            has_own, best = own, rival
    tell("bundle adjustment", 1, 2)
    model = best.fits[0].model
    apart = disagreement(model, best.fits[1].model, images.standing or None)
    if any(best.coefficients):
        verified = verified_again(matches, images.pixels, model.lenses)
    adjusted = adjust(model, tracks_of(verified, images.pixels), images.sharing(own=has_own), best.coefficients)
    return Solution(adjusted, verified, apart)


def propose(images: Images, tracks: Tracks, pairs: Pairs, tell: Progress) -> dict[bool, Adjusted]:
    """The best that the mapper finds from several focal lengths; of shared ones (False) and, where that differs, of own
    ones of every standing camera (True).

    The mapper gets lost by chance where data are few: of one kind from all starts, of the other from none. So the best
    of each kind is tried with the other kind's focal lengths as well.

    Args:
        tracks: that they are compared by; ``pairs`` are those tracks' matches.
    """
    sharing = {False: images.sharing(own=False)}
    if len(set(images.groups[: images.standing])) < images.standing:
        sharing[True] = images.sharing(own=True)
    focals = STARTS if len(images.lenses) < _MANY_IMAGES else _FEW_STARTS
    starts = [(start, own) for start in focals for own in sharing]

    def mapped(start: tuple[float, bool]) -> Model | None:
        ratio, own = start
        lenses = [replace(lens, focal=ratio * lens.width) for lens in images.lenses]
        return incremental(lenses, sharing[own], images.pixels, pairs)

    models: dict[bool, list[Adjusted]] = {own: [] for own in sharing}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the mapper works outside Python's lock, on one processor
        for index, ((_, own), model) in enumerate(zip(starts, threads.map(mapped, starts), strict=True)):
            tell("poses", index, len(starts))
            models[own] += _adjusted(model, tracks, sharing[own], models[own])
    for own in sharing:
        if others := models.get(not own):
            model = _with_shared(_best(others).model, sharing[own])
            models[own] += _adjusted(model, tracks, sharing[own], models[own])
    return {own: _best(adjusted) for own, adjusted in models.items() if adjusted}


def _best(models: Sequence[Adjusted]) -> Adjusted:
    """The one that places most images, at the least cost of all observations."""
    return min(models, key=lambda adjusted: (-len(adjusted.model.placed), adjusted.cost))


def gains(before: Float64s, after: Float64s, least: float) -> bool:
    """Whether the costs of the same tracks (count,) fell by that share of their sum, and by more than by chance.

    A paired test: with few tracks one false match that happens to fit would decide otherwise.
    """
    fell = before - after
    chance = limits.CHANCE * np.sqrt(len(fell)) * fell.std() if len(fell) else 0.0
    return bool(fell.sum() > max(least * before.sum(), chance))


def _thinned(tracks: Tracks, pairs: Pairs, images: int) -> tuple[Tracks, Pairs]:
    """Enough tracks to compare solutions by, and their matches.

    Long tracks come first. Images and pairs that see little keep all that they have.
    """
    random = np.random.default_rng(0)
    lengths = np.bincount(tracks.points, minlength=tracks.count)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    seen = np.zeros(images, np.int64)
    shared = np.zeros((images, images), np.int64)
    chosen = np.zeros(tracks.count, bool)
    for point in np.lexsort((random.random(tracks.count), -lengths)).tolist():
        own = tracks.cameras[starts[point] : starts[point + 1]]
        among = np.ix_(own, own)
        if seen[own].min() < _PER_IMAGE or shared[among].min() < _PER_PAIR:
            chosen[point] = True
            seen[own] += 1
            shared[among] += 1
    kept = tracks.chosen(chosen[tracks.points])
    known = [kept.features[kept.cameras == image] for image in range(images)]
    few = {
        (one, other): matches[np.isin(matches[:, 0], known[one]) & np.isin(matches[:, 1], known[other])]
        for (one, other), matches in pairs.items()
    }
    return kept, {pair: matches for pair, matches in few.items() if len(matches)}


def _with_shared(model: Model, groups: Sequence[int]) -> Model:
    """The model with one focal length for all images of a group, where one of them has a pose."""
    focals = np.array([lens.focal for lens in model.lenses])
    placed = np.isin(np.arange(len(focals)), model.placed)
    lenses = []
    for lens, group in zip(model.lenses, groups, strict=True):
        alike = placed & (np.array(groups) == group)
        lenses.append(replace(lens, focal=float(np.median(focals[alike]))) if alike.any() else lens)
    return Model(model.poses, tuple(lenses))


def _adjusted(model: Model | None, tracks: Tracks, groups: Sequence[int], others: Sequence[Adjusted]) -> list[Adjusted]:
    """A model after adjustment, unless it is none, or another start led to the same place."""
    if model is None or len(model.placed) < 2 or not _is_possible(model):
        return []
    if any(_same(model, other.model) for other in others):
        return []
    adjusted = adjust(model, tracks, groups, [0] * len(model.lenses))
    return [adjusted] if _is_possible(adjusted.model) else []


def _is_possible(model: Model) -> bool:
    """Whether focal lengths are above zero, which adjustment does not see to."""
    return all(model.lenses[image].focal > 0 for image in model.placed)


def _same(one: Model, other: Model) -> bool:
    """Equal but for what another adjustment would settle."""
    focals = np.array([[a.focal, b.focal] for a, b in zip(one.lenses, other.lenses, strict=True)])[one.placed]
    are_near = bool(np.abs(np.log(focals[:, 0] / focals[:, 1])).max() < _SAME_FOCAL)
    return one.placed == other.placed and are_near and disagreement(one, other) < _SAME_PLACES


def _candidates(best: dict[bool, Adjusted]) -> dict[bool, Adjusted]:
    """The best of one focal length a group; and the best of own ones, where those gain much.

    Both place as many images as any. Own focal lengths imitate lens distortion, so that a choice between the two must
    wait for it.
    """
    most = max((len(adjusted.model.placed) for adjusted in best.values()), default=0)
    starts = {own: adjusted for own, adjusted in best.items() if len(adjusted.model.placed) == most}
    if len(starts) > 1 and starts[True].cost * (1 + limits.OWN_GAINS) > starts[False].cost:
        del starts[True]
    return starts


def _with_distortion(model: Model, own: bool, tracks: Tracks, images: Images) -> _Distorted:
    """Frees k1, then k2, of all images of a kind together, where that lowers the cost of held-out tracks."""
    is_first = np.random.default_rng(1).random(tracks.count) < 0.5
    one, other = tracks.chosen(is_first[tracks.points]), tracks.chosen(~is_first[tracks.points])
    sharing = images.sharing(own=own)

    def fitted(models: tuple[Model, Model], free: list[int]) -> _Distorted:
        fits = adjust(models[0], one, sharing, free), adjust(models[1], other, sharing, free)
        return _Distorted(fits, free, np.concatenate([_held_out(fits[0], other), _held_out(fits[1], one)]))

    best = fitted((model, model), [0] * len(images.lenses))
    for kind in sorted(set(images.groups)):
        for more in (1, 2):
            before = zip(images.groups, best.coefficients, strict=True)
            tried = [more if group == kind else count for group, count in before]
            new = fitted((best.fits[0].model, best.fits[1].model), tried)
            placed = [image for image in best.fits[0].model.placed if images.groups[image] == kind]
            unsure = float(np.max([fit.uncertainty[placed] for fit in new.fits], initial=0.0))
            if not (unsure < limits.DISTORTION_SURE and gains(best.costs, new.costs, limits.DISTORTION_GAINS)):
                break
            best = new
    return best


def _held_out(adjusted: Adjusted, tracks: Tracks) -> Float64s:
    """(count,) the cost of each track that the model was not adjusted to: only its point is fitted."""
    model = adjusted.model
    _, distances = located(tracks, model)
    squares = np.minimum(distances / model.limits[tracks.cameras], 1.0) ** 2
    return summed(np.asarray(squares, np.float64), tracks)
