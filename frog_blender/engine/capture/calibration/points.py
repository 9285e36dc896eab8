"""Standing cameras from points that are known by name: what a person clicked, or a person's joints.

Nobody has to match them, so that they may be few, or seen from far apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from ...arrays import Array, Float64s, Ints
from ...errors import brief, found_instead
from ...io.plain_values import UnfitValue, entries, items, number, plain_json
from ...io.regular_file import read_text
from ..synchronization.films import CalibrationRefused, Film, Run
from . import limits
from .checks import calibration_of
from .colmap import Adjusted, adjust, verified
from .model import Calibration, Lens, Model, Tracks, tracks_of
from .structure import Images, propose
from .views import ALMOST, CameraFacts, facts_of

_LEAST_PAIR = 8  # points that two cameras share, before they are asked how they stand
_MANY = 60  # points of a pair, of which some may be false
_CLICK_REMEDY = "click more points, nearer and farther than these"
_MOST_BYTES = 2**22
_MOST_POINTS = 10_000


def solve_points(
    facts: Sequence[CameraFacts], pixels: Float64s, limit: float, remedy: str, start: Model | None = None
) -> Adjusted:
    """The rig that points fit.

    Args:
        facts: of the cameras.
        pixels: (C, P, 2), NaN where a camera did not see a point; pixel centres at +0.5.
        limit: pixels over the longer side beyond which a sighting is taken for false.
        remedy: what a person should do where the points leave something open.
        start: a model near the answer: no other one is looked for.

    Raises:
        CalibrationRefused: if the points do not join all cameras, or leave a focal length open.
    """
    sizes = [(*camera.size, 1.2 * camera.side, limit * camera.side / camera.width) for camera in facts]
    lenses = tuple(Lens(width, height, focal, tolerance=tolerance) for width, height, focal, tolerance in sizes)
    images = Images(lenses, tuple(camera.group for camera in facts), tuple(np.nan_to_num(pixels)), 0)
    seen = np.isfinite(pixels[:, :, 0])
    shared = {pair: np.flatnonzero(seen[list(pair)].all(axis=0)) for pair in combinations(range(len(facts)), 2)}
    pairs = {pair: np.stack([points, points], axis=1) for pair, points in shared.items()}
    tracks = tracks_of(pairs, images.pixels)
    if start is not None:
        adjusted = adjust(start, tracks, images.groups, [0] * len(facts))
    elif (found := _found(images, pairs, tracks)) is not None:
        adjusted = found
    else:
        fewest = sorted(shared.items(), key=lambda pair: len(pair[1]))[:6]
        poor = ", ".join(f"{facts[one].name} and {facts[other].name} ({len(own)})" for (one, other), own in fewest)
        raise CalibrationRefused(
            f"The points do not join all cameras to one rig, the fewest are shared by {poor}: {remedy}."
        )
    worst = int(np.argmax(adjusted.uncertainty))
    if not adjusted.uncertainty[worst] < limits.MOST_UNSURE:
        raise CalibrationRefused(
            f"The focal length of camera {facts[worst].name} stays uncertain by "
            f"{100 * adjusted.uncertainty[worst]:.0f} %: {remedy}."
        )
    return adjusted


def _found(images: Images, pairs: Mapping[tuple[int, int], Ints], tracks: Tracks) -> Adjusted | None:
    """The best of all starts; None where none joins all cameras."""
    enough = {pair: points for pair, points in pairs.items() if len(points) >= _LEAST_PAIR}
    for (one, other), points in enough.items():
        if len(points) >= _MANY:  # a camera may have seen another person
            first, second = ((images.lenses[index], images.pixels[index]) for index in (one, other))
            enough[one, other] = verified(*first, *second, points)
    best = propose(images, tracks, enough, lambda *_: None).get(False)
    return best if best is not None and len(best.model.placed) == len(images.lenses) else None


def calibrate_clicks(facts: Sequence[CameraFacts], clicks: Mapping[str, Float64s]) -> Calibration:
    """The rig that a person's clicks fit, at an arbitrary scale.

    Args:
        facts: of the cameras.
        clicks: for each camera's name (N, 2) pixels of the same N points, NaN where it does not see one; pixel
            centres at +0.5.

    Raises:
        CalibrationRefused: if a camera has too few points, or they leave the rig open.
    """
    count = max((len(points) for points in clicks.values()), default=0)
    pixels = np.stack([clicks.get(camera.name, np.full((count, 2), np.nan)) for camera in facts])
    seen = np.isfinite(pixels[:, :, 0])
    useful = (seen & (seen.sum(0) >= 2)).sum(1)
    for camera, count in zip(facts, useful.tolist(), strict=True):
        if count < limits.CLICKS:
            raise CalibrationRefused(
                f"Camera {camera.name} has {count} points that another camera has as well, expected {limits.CLICKS} or "
                f"more ({limits.MANY_CLICKS} are good): click corners that lie near and far, not all on one plane."
            )
    rig = solve_points(facts, pixels, limits.CLICK_FALSE, _CLICK_REMEDY)
    calibration = calibration_of([camera.name for camera in facts], rig)
    for camera, calibrated, count in zip(facts, calibration.cameras, useful.tolist(), strict=True):
        share = calibrated.support.share
        if share < limits.CLICKS_AGREEING:
            raise CalibrationRefused(
                f"{round((1 - share) * count)} of the {count} points of camera {camera.name} do not fit the others: "
                "look at whether each is the same point in every image."
            )
    if useful.min() >= limits.MANY_CLICKS:
        return calibration
    few = f"{useful.min()} points in a camera are few: with {limits.MANY_CLICKS} the rig is more certain."
    return replace(calibration, warnings=(few,))


def calibrate_click_films(run: Run, clicks: Mapping[str, Float64s], films: Sequence[Film], _count: int) -> Calibration:
    """The cameras of films by clicks in their images, in the child; see ``calibrate_clicks``."""
    return run.in_child(calibrate_clicks, facts_of(films, ALMOST), clicks)


def read_points(path: Path, sizes: Mapping[str, tuple[int, int]]) -> dict[str, Array]:
    """Clicked points of a JSON file: for each camera's name a list of [x, y] in pixels, or null where it sees none.

    Args:
        sizes: width and height of each camera's film, by name.

    Returns:
        (N, 2) float64 for each camera, NaN for null; pixel centres at +0.5.

    Raises:
        FrogError: if the file cannot be read, names another camera, or holds anything but points of the images.
    """
    content = read_text(path, "clicked points", _MOST_BYTES)
    try:
        listed = entries(plain_json(content, "a text"), "clicked points")
        if other := listed.keys() - sizes.keys():
            raise UnfitValue(f"camera {brief(min(other))}", f"one of {', '.join(sizes)}")
        clicks = {name: _clicked(points, name, sizes[name]) for name, points in listed.items()}
        counts = {len(points) for points in clicks.values()}
        if len(counts) != 1 or 0 in counts:
            numbers = ", ".join(f"{len(points)} of {name}" for name, points in clicks.items()) or "no points"
            raise UnfitValue(numbers, "the same points for each camera, null where it does not see one")
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    return clicks


def _clicked(points: object, name: str, size: tuple[int, int]) -> Array:
    pixels = []
    for row, pair in enumerate(items(points, f"points of {name}", _MOST_POINTS), 1):
        what = f"point {row} of {name}"
        if pair is not None and (type(pair) is not list or len(pair) != 2):
            raise UnfitValue(f"{what} = {brief(pair)}", "[x, y] or null")
        known = zip(pair or [], size, strict=False)
        pixels.append([number(value, what, 0, most) for value, most in known] or [np.nan, np.nan])
    return np.array(pixels, np.float64).reshape(-1, 2)
