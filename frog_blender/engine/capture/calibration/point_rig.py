"""Standing cameras from points that several of them saw, nothing else known: for points that are few or far off.

Essential matrices start it, cameras join one by one, and the bundle adjustment ends it, from several focal lengths and
several first pairs; the answer that explains most is taken, unless another one is as good and elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..video import load_opencv
from .calibration import Calibration, CalibrationRefused
from .evidence import disagreement
from .lens import Lens
from .mapping import Model
from .rig_result import CameraFacts, calibration_of
from .rig_solver import CENTER_X, FOCAL, Options, Rig, Sightings, Solution, solve

_FIRST_FOCALS = (0.6, 0.8, 1.05, 1.4, 1.9)  # of the longer side
_FIRST_PAIRS = 2  # tried for each focal length
_LEAST_PAIR = 8  # points that two cameras share
_LEAST_TO_JOIN = 6  # points that a camera shares with the rig so far
_LEAST_ANGLE = 3.0  # degrees between rays, median of a first pair
_SUBSET = 240  # points that decide between the starts
_MOST_SIGMA = 0.05  # relative, of a focal length
_AS_GOOD, _ELSEWHERE = 1.05, 0.03  # of the cost, and of the focal length: two answers
_OFTEN = 2  # sightings that place a point


@dataclass(frozen=True, eq=False)
class PointViews:
    """Points as cameras saw them.

    Attributes:
        facts: of the cameras.
        groups: (C,) cameras of one number share their focal length.
        pixels: (C, P, 2), NaN where a camera did not see a point; pixel centres at +0.5.
        limit: (C,) pixels beyond which a sighting is taken for false.
        remedy: what a person should do where the points leave something open.
        velocities: (C, P, 2) pixels a second, where the cameras' clocks are to be corrected; else None.
    """

    facts: Sequence[CameraFacts]
    groups: Ints
    pixels: Float64s
    limit: Float64s
    remedy: str
    velocities: Float64s | None = None

    @property
    def seen(self) -> Bools:
        """(C, P) who saw what."""
        return np.asarray(np.isfinite(self.pixels[:, :, 0]))

    def subset(self, points: Ints) -> PointViews:
        """The same cameras with fewer points."""
        velocities = None if self.velocities is None else self.velocities[:, points]
        return replace(self, pixels=self.pixels[:, points], velocities=velocities)


@dataclass(frozen=True, eq=False)
class PointRig:
    """A rig that points fit.

    Attributes:
        calibration: the cameras.
        rig: the same, to start from.
        shares: (C,) what part of each camera's sightings lies within the limit.
        cost: mean square pixels of all sightings, each at most its limit's.
        delays, delay_sigmas: (C,) seconds by which each film should be read later than it was, the first one's 0, and
            their standard deviations; zeros where clocks are known.
    """

    calibration: Calibration
    rig: Rig
    shares: Float64s
    cost: float
    delays: Float64s
    delay_sigmas: Float64s


class _Answer(NamedTuple):
    cost: float
    rig: Rig


class _Final(NamedTuple):
    cost: float
    solution: Solution
    sightings: Sightings


def solve_points(
    views: PointViews,
    loss: float,
    *,
    halves: Bools | None = None,
    start: Rig | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> PointRig:
    """The rig that the points fit.

    Args:
        views: what was seen.
        loss: Cauchy's scale in pixels: what a sighting is usually off by.
        halves: (P,) the points of one half, where each half is enough by itself to see whether the other agrees.
        start: a rig near the answer: no other one is looked for.
        progress: called with the part that is done.

    Raises:
        CalibrationRefused: if the points do not join all cameras, leave a focal length open, or fit two rigs.
    """
    finals = [_final(views, start, loss)] if start is not None else _found(views, loss, progress)
    cost, solution, sightings = finals[0]
    _check_focals(views, solution)
    _check_rivals(views, finals)
    is_near = _is_near(solution.rig, sightings, views.limit)
    shares = np.bincount(sightings.cameras[is_near], minlength=len(views.facts)) / np.maximum(views.seen.sum(1), 1)
    found = calibration_of(views.facts, solution, sightings, is_near)
    if halves is not None:
        found = replace(found, halves_apart=_halves_apart(views, solution.rig, halves, loss))
    delays = solution.rig.delays
    return PointRig(
        found,
        solution.rig,
        shares,
        cost / max(int(views.seen.sum()), 1),
        np.zeros(len(views.facts)) if delays is None else delays,
        solution.delay_sigmas,
    )


def _found(views: PointViews, loss: float, progress: Callable[[float], None]) -> list[_Final]:
    """Rigs from all starts, the best one first."""
    few = views.subset(_chosen(views))
    answers: list[_Answer] = []
    for number, ratio in enumerate(_FIRST_FOCALS):
        answers += _answers(few, ratio, loss)
        progress((number + 1) / (len(_FIRST_FOCALS) + 1))
    if not answers:
        raise CalibrationRefused(_unjoined(views))
    finals = [_final(views, answer.rig, loss) for answer in _apart(answers)]
    return sorted(finals, key=lambda entry: entry[0])


def _apart(answers: Sequence[_Answer]) -> list[_Answer]:
    """The best answer, and the best one that lies elsewhere."""
    best, *others = sorted(answers, key=lambda answer: answer.cost)
    return [best, *[other for other in others if _focals_apart(best.rig, other.rig) > _ELSEWHERE / 2][:1]]


def _final(views: PointViews, rig: Rig, loss: float) -> _Final:
    everyone = list(range(len(views.facts)))
    placed = _with_points(replace(rig, body_positions=np.full((views.pixels.shape[1], 3), np.nan)), views, everyone)
    sightings, bodies = _sightings(views, placed)
    start = replace(placed, body_positions=bodies, body_rotations=_upright(len(bodies)))
    if views.velocities is not None:
        start = replace(start, delays=np.zeros(len(views.facts)))
    solution = solve(start, sightings, replace(_options(start, loss), timing=views.velocities is not None))
    lost = ~np.isfinite(placed.body_positions[:, 0])
    return _Final(_truncated_cost(solution.rig, sightings, views, lost), solution, sightings)


def _halves_apart(views: PointViews, rig: Rig, halves: Bools, loss: float) -> float:
    """How far the cameras of two halves of the points lie apart at worst, over the rig's diameter."""
    models = []
    for half in (halves, ~halves):
        part = views.subset(np.flatnonzero(half))
        found = _final(part, rig, loss).solution.rig
        focals = found.lenses[found.lens_of, FOCAL].tolist()
        lenses = tuple(Lens(each.width, each.height, focal) for each, focal in zip(views.facts, focals, strict=True))
        models.append(Model(np.concatenate([found.rotations, found.translations[:, :, None]], axis=2), lenses))
    return disagreement(*models)


def _chosen(views: PointViews) -> Ints:
    """Points that many cameras saw, evenly spread over their list (which is in order of time)."""
    times = views.seen.sum(0)
    usable = np.flatnonzero(times >= min(3, len(views.facts)))
    usable = usable if len(usable) >= _SUBSET else np.flatnonzero(times >= _OFTEN)
    if len(usable) <= _SUBSET:
        return usable
    return np.random.default_rng(0).permutation(usable)[:_SUBSET]


def _options(rig: Rig, loss: float, *, fixed_lens: bool = False) -> Options:
    free = np.zeros(rig.lenses.shape, dtype=bool)
    free[:, FOCAL] = not fixed_lens
    return Options(free, turning=False, loss_scale=loss)


def _upright(count: int) -> Float64s:
    return np.tile(np.eye(3), (count, 1, 1))


def _blank_rig(views: PointViews, ratio: float) -> Rig:
    """No camera is placed yet: poses are NaN."""
    groups, lens_of = np.unique(views.groups, return_inverse=True)
    lenses = np.zeros((len(groups), 5))
    for camera, lens in zip(views.facts, lens_of.reshape(-1), strict=True):
        lenses[lens] = (ratio * camera.side, 0.0, 0.0, camera.width / 2, camera.height / 2)
    count, points = len(views.facts), views.pixels.shape[1]
    return Rig(
        np.full((count, 3, 3), np.nan),
        np.full((count, 3), np.nan),
        lenses,
        lens_of.reshape(-1),
        _upright(points),
        np.full((points, 3), np.nan),
    )


def _rays(rig: Rig, views: PointViews) -> Float64s:
    """(C, P, 2) positions in the plane at distance 1."""
    lenses = rig.lenses[rig.lens_of][:, None]
    rays: Float64s = (views.pixels - lenses[..., CENTER_X:]) / lenses[..., FOCAL, None]
    return rays


def _answers(views: PointViews, ratio: float, loss: float) -> list[_Answer]:
    blank = _blank_rig(views, ratio)
    starts = _first_pairs(blank, views)
    found = []
    for pair, pose in starts[:_FIRST_PAIRS]:
        answer = _grown(blank, views, pair, pose, loss)
        if answer is not None:
            found.append(answer)
    return found


def _first_pairs(rig: Rig, views: PointViews) -> list[tuple[tuple[int, int], Float64s]]:
    """Pairs of cameras and the second one's pose (3, 4) in the first one's axes, those with most points first."""
    cv2 = load_opencv()
    rays, seen = _rays(rig, views), views.seen
    ranked = []
    for one, other in combinations(range(len(views.facts)), 2):
        both = np.flatnonzero(seen[one] & seen[other])
        if len(both) < _LEAST_PAIR:
            continue
        first, second = np.ascontiguousarray(rays[one, both]), np.ascontiguousarray(rays[other, both])
        focals = rig.lenses[rig.lens_of[[one, other]], FOCAL]
        limit = float(np.mean(views.limit[[one, other]] / focals))
        essential, mask = cv2.findEssentialMat(first, second, np.eye(3), cv2.RANSAC, 0.9999, limit, 2000)
        if essential is None or essential.shape != (3, 3):
            continue
        inliers, rotation, shift, mask = cv2.recoverPose(essential, first, second, np.eye(3), mask=mask)
        is_inlier = mask.reshape(-1) > 0
        if inliers < _LEAST_PAIR or _median_angle(rotation, first[is_inlier], second[is_inlier]) < _LEAST_ANGLE:
            continue
        ranked.append((int(inliers), (one, other), np.column_stack([rotation, shift])))
    ranked.sort(key=lambda entry: -entry[0])
    return [(pair, pose) for _, pair, pose in ranked]


def _median_angle(rotation: Float64s, first: Float64s, second: Float64s) -> float:
    """Degrees between the rays of the same points."""
    one = np.column_stack([first, np.ones(len(first))]) @ rotation.T
    other = np.column_stack([second, np.ones(len(second))])
    cosine = (one * other).sum(1) / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _grown(blank: Rig, views: PointViews, pair: tuple[int, int], pose: Float64s, loss: float) -> _Answer | None:
    """All cameras, joined one by one to a first pair; None where one finds no place."""
    rig = _placed(_placed(blank, pair[0], np.eye(3, 4)), pair[1], pose)
    joined = list(pair)
    rig = _with_points(rig, views, joined)
    while len(joined) < len(views.facts):
        rig = _adjusted(rig, views, joined, loss, fixed_lens=True)
        rig = _with_points(rig, views, joined)
        counts = (views.seen & np.isfinite(rig.body_positions[:, 0])).sum(1)
        counts[joined] = -1
        camera = int(np.argmax(counts))
        joining = None if counts[camera] < _LEAST_TO_JOIN else _resected(rig, views, camera)
        if joining is None:
            return None
        rig = _placed(rig, camera, joining)
        joined.append(camera)
        rig = _with_points(rig, views, joined)
    for _ in range(2):  # points that were lost to a wrong focal length come back
        rig = _with_points(_adjusted(rig, views, joined, loss, fixed_lens=False), views, joined)
    sightings, bodies = _sightings(views, rig)
    found = replace(rig, body_positions=bodies, body_rotations=_upright(len(bodies)))
    return _Answer(_truncated_cost(found, sightings, views, np.isnan(rig.body_positions[:, 0])), rig)


def _placed(rig: Rig, camera: int, pose: Float64s) -> Rig:
    rotations, translations = rig.rotations.copy(), rig.translations.copy()
    rotations[camera], translations[camera] = pose[:, :3], pose[:, 3]
    return replace(rig, rotations=rotations, translations=translations)


def _with_points(rig: Rig, views: PointViews, joined: Sequence[int]) -> Rig:
    """The rig with each point where two of its rays meet: those two that the other cameras agree with most."""
    rays, seen = _rays(rig, views), views.seen
    lenses = rig.lenses[rig.lens_of]
    count = views.pixels.shape[1]
    best, positions = np.full(count, np.inf), np.full((count, 3), np.nan)
    for one, other in combinations(joined, 2):
        both = np.flatnonzero(seen[one] & seen[other])
        if not len(both):
            continue
        points = _met(rig, one, rays[one, both], other, rays[other, both])
        cost, agreeing = np.zeros(len(both)), np.zeros(len(both), dtype=np.int64)
        for camera in joined:
            local = points @ rig.rotations[camera].T + rig.translations[camera]
            depth = np.where(local[:, 2] > 0, local[:, 2], np.nan)
            off = lenses[camera, FOCAL] * (local[:, :2] / depth[:, None] - rays[camera, both])
            squared, limit = (off**2).sum(1), views.limit[camera] ** 2
            is_near = seen[camera, both] & (np.nan_to_num(squared, nan=np.inf) < limit)
            agreeing += is_near
            cost += np.where(seen[camera, both], np.where(is_near, squared, limit), 0.0)
        is_better = (agreeing >= _OFTEN) & (cost < best[both])
        best[both[is_better]], positions[both[is_better]] = cost[is_better], points[is_better]
    return replace(rig, body_positions=positions)


def _met(rig: Rig, one: int, first: Float64s, other: int, second: Float64s) -> Float64s:
    """(N, 3) points nearest to two rays each, given in the plane at distance 1."""
    origins, directions = [], []
    for camera, plane in ((one, first), (other, second)):
        rotation = rig.rotations[camera]
        direction = np.column_stack([plane, np.ones(len(plane))]) @ rotation
        directions.append(direction / np.linalg.norm(direction, axis=1, keepdims=True))
        origins.append(-rotation.T @ rig.translations[camera])
    between = origins[1] - origins[0]
    cosine = (directions[0] * directions[1]).sum(1)
    along_first, along_second = directions[0] @ between, directions[1] @ between
    sine = np.maximum(1.0 - cosine**2, 1e-12)
    near = (along_first - cosine * along_second) / sine
    far = (cosine * along_first - along_second) / sine
    middle: Float64s = (origins[0] + near[:, None] * directions[0] + origins[1] + far[:, None] * directions[1]) / 2
    return middle


def _resected(rig: Rig, views: PointViews, camera: int) -> Float64s | None:
    """(3, 4) pose of a camera that saw points of the rig."""
    cv2 = load_opencv()
    points = np.flatnonzero(views.seen[camera] & np.isfinite(rig.body_positions[:, 0]))
    focal, x, y = rig.lenses[rig.lens_of[camera]][[FOCAL, CENTER_X, CENTER_X + 1]].tolist()
    matrix = np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
    cv2.setRNGSeed(0)
    is_found, turn, shift, inliers = cv2.solvePnPRansac(
        rig.body_positions[points],
        views.pixels[camera, points],
        matrix,
        None,
        iterationsCount=500,
        reprojectionError=float(2 * views.limit[camera]),
        confidence=0.9999,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not is_found or inliers is None or len(inliers) < _LEAST_TO_JOIN:
        return None
    return np.column_stack([cv2.Rodrigues(turn)[0], shift])


def _adjusted(rig: Rig, views: PointViews, joined: Sequence[int], loss: float, *, fixed_lens: bool) -> Rig:
    """The rig after a bundle adjustment of the cameras that have joined it."""
    order = np.array(joined)
    known = np.flatnonzero(np.isfinite(rig.body_positions[:, 0]))
    part = Rig(
        rig.rotations[order],
        rig.translations[order],
        rig.lenses,
        rig.lens_of[order],
        _upright(len(known)),
        rig.body_positions[known],
    )
    cameras, points = np.nonzero(views.seen[order][:, known])
    sightings = Sightings(cameras, points, np.zeros((len(points), 3)), views.pixels[order[cameras], known[points]])
    found = solve(
        part, sightings, replace(_options(part, loss, fixed_lens=fixed_lens), iterations=25, least_gain=1e-3)
    ).rig
    rotations, translations, positions = rig.rotations.copy(), rig.translations.copy(), rig.body_positions.copy()
    rotations[order], translations[order], positions[known] = found.rotations, found.translations, found.body_positions
    return replace(rig, rotations=rotations, translations=translations, lenses=found.lenses, body_positions=positions)


def _sightings(views: PointViews, rig: Rig) -> tuple[Sightings, Float64s]:
    """All sightings of points that have a place, and those places."""
    known = np.flatnonzero(np.isfinite(rig.body_positions[:, 0]))
    cameras, points = np.nonzero(views.seen[:, known])
    velocities = None if views.velocities is None else views.velocities[cameras, known[points]]
    sightings = Sightings(cameras, points, np.zeros((len(points), 3)), views.pixels[cameras, known[points]], velocities)
    return sightings, rig.body_positions[known]


def _is_near(rig: Rig, sightings: Sightings, limit: Float64s) -> Bools:
    return np.asarray(np.linalg.norm(rig.residuals(sightings), axis=1) < limit[sightings.cameras])


def _truncated_cost(rig: Rig, sightings: Sightings, views: PointViews, lost: Bools) -> float:
    """Square pixels of all sightings, each at most the limit's; those of points without a place count that much."""
    squared, limits = (rig.residuals(sightings) ** 2).sum(1), views.limit**2
    return float(np.minimum(squared, limits[sightings.cameras]).sum() + limits @ views.seen[:, lost].sum(1))


def _unjoined(views: PointViews) -> str:
    seen = views.seen
    shared = {
        f"{views.facts[one].name} and {views.facts[other].name}": int((seen[one] & seen[other]).sum())
        for one, other in combinations(range(len(views.facts)), 2)
    }
    poor = ", ".join(f"{pair} ({count})" for pair, count in sorted(shared.items(), key=lambda entry: entry[1])[:6])
    return f"The points do not join all cameras to one rig, the fewest are shared by {poor}: {views.remedy}."


def _focals_apart(one: Rig, other: Rig) -> float:
    return float(np.abs(other.lenses[:, FOCAL] / one.lenses[:, FOCAL] - 1.0).max())


def _check_rivals(views: PointViews, finals: Sequence[_Final]) -> None:
    best, *others = finals
    apart = max(_ELSEWHERE, 3.0 * float(best.solution.lens_sigmas[:, FOCAL].max()))
    for other in others:
        if other.cost <= _AS_GOOD * best.cost and _focals_apart(best.solution.rig, other.solution.rig) > apart:
            one, two = (float(each.solution.rig.lenses[0, FOCAL]) for each in (best, other))
            raise CalibrationRefused(
                f"The points fit two rigs equally well, with focal lengths of {one:.0f} and {two:.0f} pixels for "
                f"camera {views.facts[0].name}: {views.remedy}."
            )


def _check_focals(views: PointViews, solution: Solution) -> None:
    sigmas = solution.lens_sigmas[solution.rig.lens_of, FOCAL]
    worst = int(np.argmax(sigmas))
    if not sigmas[worst] < _MOST_SIGMA:
        raise CalibrationRefused(
            f"The focal length of camera {views.facts[worst].name} stays uncertain by {100 * sigmas[worst]:.0f} %: "
            f"{views.remedy}."
        )
