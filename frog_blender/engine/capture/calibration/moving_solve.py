"""From matches between the images of moving cameras to a pose for each, and one lens for each kind of camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...arrays import Float64s
from .adjustment import Adjusted, adjust
from .belief import doubts, is_apart, is_unsure, percent
from .calibration import CalibrationRefused
from .evidence import disagreement
from .hypotheses import Hypothesis, candidates, rivals, whole_cost
from .lens import Lens
from .mapping import Model, global_, incremental
from .release import released
from .tracks import Pairs, Tracks
from .walk import EXHAUSTIVE, Tell, Walk

_STARTS = (0.9, 1.3)
_LEAST_PLACED = 0.8  # of the images of a camera
REMEDY = (
    "Next time move the camera sideways, slowly and without turning on the spot, past textured things that rest, or "
    "film with several standing cameras."
)


@dataclass(frozen=True, eq=False)
class MovingSolution:
    """What came of the images.

    Attributes:
        adjusted: poses, lenses and points.
        coefficients: for each image how many of k1 and k2 are free.
        unsure: the largest standard deviation of a focal length, over it.
        apart: how far half of the points put an image from where the other half does, over the path's size.
        costs: of all starts that found a model.
        warnings: one sentence each.
    """

    adjusted: Adjusted
    coefficients: tuple[int, ...]
    unsure: float
    apart: float
    costs: tuple[float, ...]
    warnings: tuple[str, ...]


def solve_moving(
    walks: Sequence[Walk], pixels: Sequence[Float64s], pairs: Pairs, tracks: Tracks, tell: Tell
) -> MovingSolution:
    """The poses of moving cameras.

    Args:
        pixels: (N, 2) of the features of each image, walk by walk.
        pairs: verified matches; ``tracks`` joins them.

    Raises:
        CalibrationRefused: if the images do not fix the poses.
    """
    sizes = [walk.size for walk in walks for _ in walk.images]
    groups = [walk.group for walk in walks for _ in walk.images]
    found = _proposed(sizes, groups, pixels, pairs, tracks, tell=tell)
    models = candidates(found)
    if not models:
        raise CalibrationRefused(f"No two images of the moving camera could be placed. {REMEDY}")
    chosen = models[0]
    assert chosen.adjusted is not None
    warnings = _unplaced(walks, chosen.adjusted.model.placed)
    tell("bundle adjustment", 0, 3)
    freed = released(chosen.adjusted.model, tracks, groups, groups)
    tell("bundle adjustment", 1, 3)
    apart = disagreement(freed.fits[0].model, freed.fits[1].model)
    adjusted = adjust(chosen.adjusted.model, tracks, groups, freed.coefficients)
    tell("bundle adjustment", 2, 3)
    unsure = float(adjusted.uncertainty[adjusted.model.placed].max())
    _check(chosen, found, unsure, apart)
    warnings += doubts(unsure, apart, "the path's size")
    costs = tuple(each.cost for each in found if each.adjusted is not None)
    return MovingSolution(adjusted, tuple(freed.coefficients), unsure, apart, costs, tuple(warnings))


def _proposed(
    sizes: Sequence[tuple[int, int]],
    groups: Sequence[int],
    pixels: Sequence[Float64s],
    pairs: Pairs,
    tracks: Tracks,
    *,
    tell: Tell,
) -> list[Hypothesis]:
    """What the mappers find: the incremental one from several focal lengths, and for many images the global one."""
    found = []
    for place, start in enumerate(_STARTS):
        tell("poses", place, len(_STARTS))
        lenses = [Lens(*size, start * size[0]) for size in sizes]
        by_global = len(pixels) > EXHAUSTIVE and place == 0
        model = (global_ if by_global else incremental)(lenses, groups, pixels, pairs)
        if model is None or len(model.placed) < 2:
            found.append(Hypothesis(start, False, None, 1.0))
            continue
        adjusted = adjust(_uniform(model, groups), tracks, groups, [0] * len(pixels))
        found.append(Hypothesis(start, False, adjusted, whole_cost(adjusted.distances, tracks, adjusted.model.lenses)))
    return found


def _uniform(model: Model, groups: Sequence[int]) -> Model:
    """The model with each group's one lens for images that have no pose as well."""
    known = {groups[index]: model.lenses[index] for index in reversed(model.placed)}
    lenses = (known.get(group, lens) for group, lens in zip(groups, model.lenses, strict=True))
    return Model(model.poses, tuple(lenses))


def _unplaced(walks: Sequence[Walk], placed: Sequence[int]) -> list[str]:
    """Warnings for the images without a pose; CalibrationRefused where a camera has too many of them."""
    warnings, start = [], 0
    for walk in walks:
        count = len(walk.images)
        lost = count - sum(start <= index < start + count for index in placed)
        start += count
        whose = f" of {walk.name}" if len(walks) > 1 else ""
        sentence = f"{lost} of {count} images{whose} could not be placed"
        if lost > (1 - _LEAST_PLACED) * count:
            beside = " beside those of the other cameras: film past the same things" if len(walks) > 1 else ""
            raise CalibrationRefused(f"{sentence}{beside}. {REMEDY}")
        if lost:
            warnings.append(f"{sentence}.")
    return warnings


def _check(chosen: Hypothesis, found: Sequence[Hypothesis], unsure: float, apart: float) -> None:
    """CalibrationRefused where the solution cannot be believed."""
    if is_unsure(unsure):
        raise CalibrationRefused(f"The images do not fix the focal length. {REMEDY}")
    if others := rivals(found, chosen):
        factor = others[0][1]
        raise CalibrationRefused(
            f"Two solutions fit the images equally well, with focal lengths a factor {factor:.2f} apart. {REMEDY}"
        )
    if is_apart(apart):
        raise CalibrationRefused(
            f"Two halves of the points put the camera {percent(apart)} of its path apart. {REMEDY}"
        )
