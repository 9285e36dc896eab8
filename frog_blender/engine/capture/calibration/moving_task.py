"""The child's task for one moving camera: images in order to a pose for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import combinations
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...io.plain_values import JsonObject
from ..video import read_gray
from .adjustment import adjust
from .calibration import CalibrationRefused
from .evidence import agreeing, disagreement
from .features import SMALL, Extractor, Features
from .films import resized
from .hypotheses import Hypothesis, candidates, halves, held_out_cost, rivals, whole_cost
from .lens import Lens
from .mapping import Model, global_, incremental
from .matching import match
from .rig_world import oriented
from .tracks import Pairs, Tracks, join
from .two_view import verified
from .work_folder import WorkFolder, key_of, key_of_file

Tell = Callable[[str, int, int], None]
_EXHAUSTIVE = 60  # images up to which every pair is matched, and the incremental mapper alone is asked
_OVERLAP = 10  # neighbours in time that an image is matched with, besides those 2, 4, 8, ... images away
_STARTS = (0.9, 1.3)
_LEAST_PLACED = 0.8  # of the images
_UNSURE, _DOUBTFUL = 0.05, 0.02  # standard deviation of the focal length
_APART, _DOUBTFUL_APART = 0.03, 0.01  # of the path's size
_RELEASE_GAINS, _RELEASE_SURE = 0.002, 0.02
_REMEDY = (
    "Next time move the camera sideways, slowly and without turning on the spot, past textured things that rest, or "
    "film with several standing cameras."
)


def moving(request: JsonObject, tell: Tell) -> JsonObject:
    """The poses of a moving camera, for a request by ``moving.calibrate_moving``.

    Raises:
        CalibrationRefused: if the images do not fix the poses.
        FrogError: for an image that cannot be read.
    """
    work = WorkFolder(Path(request["work"]))
    size = (int(request["size"][0]), int(request["size"][1]))
    images = [Path(name) for name in request["images"]]
    keys = [key_of(key_of_file(path)) for path in images]
    features = []
    for place, (path, key) in enumerate(zip(images, keys, strict=True)):
        tell("features", place, len(images))
        features.append(_features(work, path, key, size))
    pairs = _pairs(work, features, size, keys, tell)
    tracks = join(pairs, [each.pixels for each in features])
    found = _proposed([each.pixels for each in features], size, pairs, tracks, tell)
    models = candidates(found)
    if not models:
        raise CalibrationRefused(f"No two images of the moving camera could be placed. {_REMEDY}")
    return _judged(models[0], found, tracks, tell)


def _features(work: WorkFolder, path: Path, key: str, size: tuple[int, int]) -> Features:
    kept = work.load("image", key)
    if kept is None:
        gray = resized(read_gray(path), size)
        pixels, descriptors = Extractor(upsampled=max(size) < SMALL).of(gray)
        scale = np.array(size) / gray.shape[::-1]
        kept = {"pixels": pixels.astype(np.float64) * scale, "descriptors": descriptors}
        work.keep("image", key, kept)
    return Features(kept["pixels"], kept["descriptors"], np.zeros(len(kept["pixels"]), np.int64))


def _pairs(work: WorkFolder, features: Sequence[Features], size: tuple[int, int], keys: list[str], tell: Tell) -> Pairs:
    """Verified matches, of an earlier run or new."""
    key = key_of(keys)
    kept = work.load("sequence", key)
    if kept is None:
        lens = Lens(*size, 1.2 * size[0])
        wanted, kept = _neighbours(len(features)), {}
        for place, (one, other) in enumerate(wanted):
            tell("matches", place, len(wanted))
            a, b = features[one], features[other]
            checked = verified(lens, a.pixels, lens, b.pixels, match(a, b))
            if len(checked):
                kept[f"{one} {other}"] = checked
        work.keep("sequence", key, kept)
    return {(int(name.split()[0]), int(name.split()[1])): array for name, array in kept.items()}


def _neighbours(count: int) -> list[tuple[int, int]]:
    """Pairs of images to match: all of few, else those near in time and at growing distances."""
    if count <= _EXHAUSTIVE:
        return list(combinations(range(count), 2))
    steps = sorted({*range(1, _OVERLAP + 1), *(2**power for power in range(4, 12))})
    return [(one, one + step) for one in range(count) for step in steps if one + step < count]


def _proposed(
    pixels: Sequence[Float64s], size: tuple[int, int], pairs: Pairs, tracks: Tracks, tell: Tell
) -> list[Hypothesis]:
    """What the mappers find: the incremental one from several focal lengths, and for many images the global one."""
    groups = [0] * len(pixels)
    found = []
    for place, start in enumerate(_STARTS):
        tell("poses", place, len(_STARTS))
        lenses = [Lens(*size, start * size[0])] * len(pixels)
        by_global = len(pixels) > _EXHAUSTIVE and place == 0
        model = (global_ if by_global else incremental)(lenses, groups, pixels, pairs)
        if model is None or len(model.placed) < 2:
            found.append(Hypothesis(start, False, None, 1.0))
            continue
        adjusted = adjust(_uniform(model), tracks, groups, [0] * len(pixels))
        found.append(Hypothesis(start, False, adjusted, whole_cost(adjusted.distances, tracks, adjusted.model.lenses)))
    return found


def _uniform(model: Model) -> Model:
    """The model with its one lens for images that have no pose as well."""
    return Model(model.poses, (model.lenses[model.placed[0]],) * len(model.lenses))


def _judged(chosen: Hypothesis, found: Sequence[Hypothesis], tracks: Tracks, tell: Tell) -> JsonObject:
    """The result, with distortion where held-out tracks ask for it; CalibrationRefused where it cannot be believed."""
    assert chosen.adjusted is not None
    tell("bundle adjustment", 0, 3)
    model = chosen.adjusted.model
    count, placed = len(model.lenses), model.placed
    if len(placed) < _LEAST_PLACED * count:
        raise CalibrationRefused(f"{count - len(placed)} of {count} images could not be placed. {_REMEDY}")
    groups = [0] * count
    one, other = halves(tracks)
    coefficients = 0
    fits = [adjust(model, half, groups, [0] * count) for half in (one, other)]
    least = held_out_cost(fits[0], other) + held_out_cost(fits[1], one)
    for more in (1, 2):
        tried = [adjust(fit.model, half, groups, [more] * count) for fit, half in zip(fits, (one, other), strict=True)]
        gained = held_out_cost(tried[0], other) + held_out_cost(tried[1], one)
        sure = max(float(each.uncertainty[each.model.placed].max()) for each in tried) < _RELEASE_SURE
        if not (sure and gained < (1 - _RELEASE_GAINS) * least):
            break
        coefficients, least, fits = more, gained, tried
    tell("bundle adjustment", 1, 3)
    apart = disagreement(fits[0].model, fits[1].model)
    adjusted = adjust(model, tracks, groups, [coefficients] * count)
    tell("bundle adjustment", 2, 3)
    unsure = float(adjusted.uncertainty[adjusted.model.placed].max())
    if not unsure <= _UNSURE:
        raise CalibrationRefused(f"The images do not fix the focal length. {_REMEDY}")
    if others := rivals(found, chosen):
        factor = others[0][1]
        raise CalibrationRefused(
            f"Two solutions fit the images equally well, with focal lengths a factor {factor:.2f} apart. {_REMEDY}"
        )
    if apart > _APART:
        raise CalibrationRefused(
            f"Two halves of the points put the camera {100 * apart:.1f} % of its path apart. {_REMEDY}"
        )
    warnings = [] if len(placed) == count else [f"{count - len(placed)} of {count} images could not be placed."]
    if unsure > _DOUBTFUL:
        warnings.append(f"The focal length is known within {100 * unsure:.1f} % only.")
    if apart > _DOUBTFUL_APART:
        warnings.append(f"The camera's positions are known within about {100 * apart:.1f} % of its path only.")
    oriented_model, points = oriented(adjusted.model, adjusted.points)
    agree = agreeing(adjusted, tracks)
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    sure_points = np.isfinite(points).all(axis=1) & (lengths >= 3)
    return {
        "lens": asdict(adjusted.model.lenses[placed[0]]),
        "placed": placed,
        "poses": oriented_model.poses[placed].tolist(),
        "points": points[sure_points][:8000].round(5).tolist(),
        "residual": float(np.median(adjusted.distances[agree])),
        "focal_uncertainty": unsure,
        "halves_apart": apart,
        "costs": [each.cost for each in found if each.adjusted is not None],
        "warnings": warnings,
    }
