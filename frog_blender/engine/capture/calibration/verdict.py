"""Whether a solution is to be believed: what is not gets a sentence that names cameras, and says what to film.

A low residual proves nothing, so none of these tests looks at it. What they ask is whether independent parts of the
data agree: three cameras about a point, three rotations around a triangle, two starts, two halves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .belief import LEAST_SHARED, disagrees, doubts, is_apart, is_contradicted, is_doubtful, is_unsure, is_weak, percent
from .evidence import CLOSES, PairEvidence
from .solve import Solution

_FEW_CLOSING = 0.5
_FEW_AGREEING = 0.5
_PARALLEL = 5.0  # degrees between the directions of all cameras: so little fixes no focal length
_NAMED = 6  # pairs

REMEDY = (
    "Next time hold a ChArUco board into the views of neighbouring cameras, set the cameras closer together, or film "
    "a slow walk through the empty set with one more camera"
)
"""What to film where cameras are not connected."""


def refusal(solution: Solution, names: Sequence[str]) -> str | None:
    """Why the solution must not be used, in one sentence; None where nothing speaks against it."""
    adjusted = solution.adjusted
    placed = adjusted.model.placed if adjusted is not None else []
    if len(names) < 3:
        return (
            f"{len(names)} standing cameras cannot be calibrated from their images: a single pair proves nothing. "
            "Next time film with at least three cameras, or hold a ChArUco board into the views."
        )
    if len(placed) < len(names) or adjusted is None:
        lost = [name for index, name in enumerate(names) if index not in placed]
        return _unconnected(solution, names, lost if placed else list(names))
    weak = [names[i] for i, each in enumerate(solution.cameras) if is_weak(each)]
    if weak:
        return _unconnected(solution, names, weak)
    open_ = [names[i] for i, each in enumerate(solution.cameras) if is_contradicted(each)]
    if open_:
        return (
            f"The views of {listed(open_)} contradict the others: the rotations of most triangles of cameras do not "
            f"close within {CLOSES:g} degrees. {REMEDY}."
        )
    unsure = max(each.focal_uncertainty for each in solution.cameras)
    if is_unsure(unsure):
        return f"The images do not fix the focal length (within {percent(unsure)}). {_fixing_focals(solution)}"
    if solution.rivals:
        _, factor = max(solution.rivals, key=lambda each: abs(np.log(each[1])))
        return (
            f"Two solutions fit the images equally well, with focal lengths a factor {factor:.2f} apart. "
            + _fixing_focals(solution)
        )
    if is_apart(solution.halves_apart):
        return (
            f"Two halves of the points put the cameras {percent(solution.halves_apart)} of the rig's size apart: "
            f"there are too few. {REMEDY}."
        )
    return None


def warnings(solution: Solution, names: Sequence[str]) -> list[str]:
    """Sentences about what is in doubt though nothing speaks against it."""
    found = []
    weak = [names[i] for i, each in enumerate(solution.cameras) if is_doubtful(each)]
    if weak:
        found.append(f"Few points are seen by {listed(weak)} and two other cameras at once: look at the result.")
    alone = [names[i] for i, each in enumerate(solution.cameras) if np.isnan(each.closing)]
    if alone:
        found.append(f"No triangle of matching pairs tests {listed(alone)}: look at the result.")
    pairs = [f"{names[pair.one]}-{names[pair.other]}" for pair in _contradicting(solution)]
    if pairs:
        found.append(f"Most matches of {listed(pairs)} contradict the solution: look at the result.")
    found += doubts(max(each.focal_uncertainty for each in solution.cameras), solution.halves_apart, "the rig's size")
    doubted = [names[i] for i, each in enumerate(solution.cameras) if disagrees(each)]
    if doubted:
        found.append(f"Most matches of {listed(doubted)} disagree with the solution: look at the result.")
    return found


def _contradicting(solution: Solution) -> list[PairEvidence]:
    """The pairs, of cameras whose triangles seldom close, most of whose matches the solution does not explain.

    That triangles do not close is not enough: where a third of a pair's matches are false and alike, as on a wallpaper,
    its own rotation is off by degrees while the solution, from all pairs, explains the rest.
    """
    return [
        pair
        for pair in solution.pairs
        if min(solution.cameras[pair.one].closing, solution.cameras[pair.other].closing) < _FEW_CLOSING
        and pair.agreeing < _FEW_AGREEING * pair.verified
    ]


def _fixing_focals(solution: Solution) -> str:
    """What to film so that focal lengths are fixed.

    Cameras that only shift leave them open whatever they see: the depth of everything and the focal length trade off.
    """
    assert solution.adjusted is not None
    model = solution.adjusted.model
    ahead = model.poses[model.placed][:, 2, :3]
    if np.degrees(np.arccos(np.clip((ahead @ ahead.T).min(), -1, 1))) < _PARALLEL:
        return "Turn the cameras towards one place: they look in the same direction; or hold a ChArUco board."
    return "Next time fill more of the images with textured things at different depths, or hold a ChArUco board."


def _unconnected(solution: Solution, names: Sequence[str], lost: Sequence[str]) -> str:
    """The refusal for cameras that share no points with two others, with the pairs that do match."""
    agreeing = [pair for pair in solution.pairs if pair.agreeing >= LEAST_SHARED]
    apart = [
        f"{names[pair.one]}-{names[pair.other]}"
        for pair in solution.pairs
        if pair.agreeing < LEAST_SHARED and not {names[pair.one], names[pair.other]}.isdisjoint(lost)
    ]
    matching = [
        f"{names[pair.one]}-{names[pair.other]} ({pair.agreeing} points)"
        for pair in sorted(agreeing, key=lambda pair: -pair.agreeing)
    ]
    only = f"only {listed(matching)} match" + ("es" if len(matching) == 1 else "") if matching else "no pair matches"
    return (
        f"{listed(lost)} share{'s' if len(lost) == 1 else ''} no points with two other cameras at once: {only}, "
        f"and {listed(apart)} do not. {REMEDY}."
    )


def listed(names: Sequence[str], most: int = _NAMED) -> str:
    """Names in a sentence, the first ``most`` of more."""
    shown = list(names[:most])
    if len(names) > most:
        return f"{', '.join(shown)} and {len(names) - most} more"
    return ", ".join(shown[:-1]) + (" and " if len(shown) > 1 else "") + shown[-1] if shown else "none"
