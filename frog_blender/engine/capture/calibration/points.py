"""Standing cameras from points that are known by name: what a person clicked, or a person's joints.

Nobody has to match them, so that they may be few, or seen from far apart. Where they move, they tell the films' clocks
as well, by one step of Gauss and Newton from adjusted cameras: COLMAP's adjustment has no clocks.
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
from .colmap import SOFT, Adjusted, adjust, verified
from .model import Calibration, Lens, Model, Tracks, summed, tracks_of
from .structure import Images, propose
from .views import ALMOST, CameraFacts, facts_of

_LEAST_PAIR = 8  # points that two cameras share, before they are asked how they stand
_MANY = 60  # points of a pair, of which some may be false
_CLICK_REMEDY = "click more points, nearer and farther than these"
_MOST_BYTES = 2**22
_MOST_POINTS = 10_000
_POSE = 6  # unknowns: a turn about the camera's own origin, then a shift


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


# --- clocks


def clock_steps(adjusted: Adjusted, velocities: Float64s, groups: Sequence[int]) -> tuple[Float64s, Float64s]:
    """By how many seconds each film should be read later, (C,), the first one 0, and their standard deviations.

    Poses, focal lengths and points may follow the clocks.

    Args:
        adjusted: without lens distortion. Observations of points that it does not locate are left out.
        velocities: (N, 2) pixels a second by which observations move with their camera's clock.
        groups: cameras of one number, counted from 0, share their focal length.
    """
    known = np.isfinite(adjusted.points).all(axis=1)
    is_known = known[adjusted.tracks.points]
    moving, used = velocities[is_known], adjusted.tracks.chosen(is_known)
    off, by_shared, by_point = _jacobians(adjusted.model, adjusted.points[known], used, moving, groups)
    squares = (off**2).sum(axis=1)
    weights = 1.0 / (1.0 + squares / (SOFT * adjusted.model.limits.min()) ** 2)  # Cauchy's
    weights[~by_shared.any(axis=(1, 2))] = 0.0  # behind its camera
    heavy_shared, heavy_point = by_shared * weights[:, None, None], by_point * weights[:, None, None]
    # The points are eliminated (Schur complement).
    own = summed(np.einsum("nai,naj->nij", heavy_point, by_point), used)
    inverse = np.linalg.inv(own + 1e-9 * np.eye(3) * (1.0 + np.trace(own, axis1=1, axis2=2))[:, None, None])
    mixed = summed(np.einsum("nai,naj->nij", by_shared, heavy_point), used) @ inverse
    slope = np.einsum("nai,na->i", heavy_shared, off)
    slope -= np.einsum("pij,pj->i", mixed, summed(np.einsum("nai,na->ni", heavy_point, off), used))
    curvature = np.einsum("nai,naj->ij", heavy_shared, by_shared, optimize=True)
    curvature -= np.einsum("pij,pjk,plk->il", mixed, own, mixed, optimize=True)
    # The world's free scale, and what is held, have no curvature: their directions are left out.
    diagonal = curvature.diagonal()
    scaled = np.where(diagonal > 1e-9 * diagonal.max(), 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0)
    scales = np.outer(scaled, scaled)
    covariance = scales * np.linalg.pinv(curvature * scales, rcond=1e-10, hermitian=True)
    unknowns = int((scaled > 0).sum()) + 3 * len(own)
    spread = (weights * squares).sum() / max(2.0 * weights.sum() - unknowns, 1.0)
    clocks = slice(len(slope) - len(groups), None)
    sigmas = np.sqrt(np.maximum(covariance.diagonal(), 0.0) * spread)
    return -(covariance @ slope)[clocks], sigmas[clocks]


def _jacobians(
    model: Model, points: Float64s, tracks: Tracks, velocities: Float64s, groups: Sequence[int]
) -> tuple[Float64s, Float64s, Float64s]:
    """(N, 2) pixels from where points were seen to where they should be, and how these change with what cameras share
    (N, 2, n) and with the points (N, 2, 3); zeros for a point behind its camera.

    What cameras share is every camera's pose, every group's focal length (its logarithm), every camera's clock.
    """
    count, rows = len(groups), np.arange(len(tracks.points))
    pose = model.poses[tracks.cameras]
    local = np.einsum("nij,nj->ni", pose[:, :, :3], points[tracks.points]) + pose[:, :, 3]
    is_before = local[:, 2] > 0
    depth = np.where(is_before, local[:, 2], 1.0)
    flat = local[:, :2] / depth[:, None]
    lenses = np.array([[lens.focal, lens.width / 2, lens.height / 2] for lens in model.lenses])[tracks.cameras]
    focal = lenses[:, 0]
    off = focal[:, None] * flat + lenses[:, 1:] - tracks.pixels
    by_local = np.zeros((len(rows), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = focal / depth
    by_local[:, :, 2] = -focal[:, None] * flat / depth[:, None]
    by_shared = np.zeros((len(rows), 2, (_POSE + 1) * count + 1 + max(groups)))
    for axis in range(3):
        turned = np.cross(np.eye(3)[axis], local)
        by_shared[rows, :, _POSE * tracks.cameras + axis] = np.einsum("nai,ni->na", by_local, turned)
        by_shared[rows, :, _POSE * tracks.cameras + 3 + axis] = by_local[:, :, axis]
    by_shared[rows, :, _POSE * count + np.array(groups)[tracks.cameras]] = focal[:, None] * flat
    by_shared[rows, :, by_shared.shape[2] - count + tracks.cameras] = -velocities
    by_shared[:, :, [*range(_POSE), by_shared.shape[2] - count]] = 0.0  # the first camera's pose and clock are held
    is_before = is_before[:, None]
    return off * is_before, by_shared * is_before[..., None], by_local @ pose[:, :, :3] * is_before[..., None]
