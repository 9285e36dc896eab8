"""Cameras from a calibration board that they saw: lenses, poses, and the metric scale from its squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array, Bools, Float64s
from ..video import load_opencv
from .board_detection import Board, Corners
from .calibration import Calibration, CalibrationRefused
from .rig_result import CameraFacts, calibration_of
from .rig_solver import CENTER_X, CENTER_Y, FOCAL, K1, K2, Options, Rig, Sightings, Solution, solve

_FIRST_FOCALS = (0.45, 0.7, 1.0, 1.5, 2.4)  # of the longer side
_LOSS = 2.0  # pixels
_LOOSE_LOSS = 20.0  # pixels, before the poses of all cameras fit together
_LEAST_IMAGES = 5  # that show the board, of each camera
_LEAST_SHARED = 3  # frames in which two cameras saw the board at once
_MOST_SCATTER = 15.0  # degrees by which half the frames may disagree on how two cameras stand
_MOST_SIGMA = 0.05  # relative, of a focal length
_MOST_RESIDUAL, _DOUBTFUL_RESIDUAL = 0.004, 0.0015  # of the longer side, median of a camera
_FALSE = 0.008  # of the longer side: a corner that is farther off is another one
_GAIN = 0.02  # by which a camera's held-out cost must fall for one more lens parameter
_CORNER_SIGMA = 0.01  # of the distance from the middle, at the image's corner: the most a coefficient may leave open
_CENTER_SIGMA = 0.001  # of the longer side
_HELD_OUT = 3  # every third frame


@dataclass(frozen=True, eq=False)
class _Seen:
    """All corners, their frames numbered from 0; ``poses[camera][frame]`` (4, 4) takes the board to the camera."""

    facts: Sequence[CameraFacts]
    sightings: Sightings
    frames: int


def calibrate_board(
    facts: Sequence[CameraFacts], board: Board, corners: Sequence[Sequence[Corners | None]]
) -> Calibration:
    """The rig that saw the board.

    Args:
        facts: of the cameras.
        board: as it is; without its squares' size, the rig's scale is arbitrary.
        corners: for each camera and each common time what it saw of the board.

    Raises:
        CalibrationRefused: if a camera saw the board too seldom, never together with the others, or not tilted enough
            for its focal length.
    """
    _check_counts(facts, corners)
    seen = _sightings(facts, board, corners)
    singles = [_single_camera(seen, camera) for camera in range(len(facts))]
    rig = _assembled(seen, singles, _relative_poses(seen, singles))
    rig = solve(rig, seen.sightings, _options(np.zeros((len(facts), 5), dtype=bool), _LOOSE_LOSS)).rig
    free = np.zeros((len(facts), 5), dtype=bool)
    free[:, [FOCAL, K1]] = True
    first = solve(rig, seen.sightings, _options(free, _LOSS))
    solution = _with_more_of_the_lenses(seen, first, free)
    warnings = _check(seen, board, solution)
    if not board.square:
        warnings.append(f"The size of the squares of {board} is not given: the rig's scale is arbitrary.")
    limits = _FALSE * np.array([camera.side for camera in facts])
    agrees = np.linalg.norm(solution.rig.residuals(seen.sightings), axis=1) < limits[seen.sightings.cameras]
    found = calibration_of(facts, solution, seen.sightings, agrees, is_metric=board.square is not None)
    return replace(found, warnings=tuple(warnings))


def _options(free: Bools, loss: float, *, holding: bool = False) -> Options:
    return Options(free, turning=True, loss_scale=loss, iterations=100, holding=holding)


def _check_counts(facts: Sequence[CameraFacts], corners: Sequence[Sequence[Corners | None]]) -> None:
    for camera, found in zip(facts, corners, strict=True):
        count = sum(each is not None for each in found)
        if count < _LEAST_IMAGES:
            raise CalibrationRefused(
                f"Camera {camera.name} shows the board in {count} of {len(found)} images, expected {_LEAST_IMAGES} "
                "or more: move the board through what each camera sees, tilted, slowly, and near enough to fill a "
                "quarter of its image."
            )


def _sightings(facts: Sequence[CameraFacts], board: Board, corners: Sequence[Sequence[Corners | None]]) -> _Seen:
    """All corners; a frame in which nobody saw the board is left out."""
    frames = [time for time in range(len(corners[0])) if any(found[time] is not None for found in corners)]
    cameras: list[Array] = []
    bodies: list[Array] = []
    places: list[Array] = []
    pixels: list[Array] = []
    for camera, found in enumerate(corners):
        for frame, time in enumerate(frames):
            each = found[time]
            if each is not None:
                cameras.append(np.full(len(each.numbers), camera))
                bodies.append(np.full(len(each.numbers), frame))
                places.append(board.places[each.numbers])
                pixels.append(each.pixels)
    joined = Sightings(*(np.concatenate(parts) for parts in (cameras, bodies, places, pixels)))
    return _Seen(facts, joined, len(frames))


def _single_camera(seen: _Seen, camera: int) -> tuple[Float64s, dict[int, Float64s]]:
    """A camera's lens (5,) by itself, and the board's pose (4, 4) in its axes by frame."""
    facts, sightings = seen.facts[camera], seen.sightings
    rows = sightings.where(sightings.cameras == camera)
    frames, bodies = np.unique(rows.bodies, return_inverse=True)
    own = replace(rows, cameras=np.zeros(len(rows), dtype=np.int64), bodies=bodies.reshape(-1))
    free = np.zeros((1, 5), dtype=bool)
    free[0, FOCAL] = True
    best: Solution | None = None
    for ratio in _FIRST_FOCALS:
        lens = np.array([[ratio * facts.side, 0.0, 0.0, facts.width / 2, facts.height / 2]])
        poses = np.stack([_board_pose(own.where(own.bodies == body), lens[0]) for body in range(len(frames))])
        rig = Rig(np.eye(3)[None], np.zeros((1, 3)), lens, np.zeros(1, np.int64), poses[:, :3, :3], poses[:, :3, 3])
        found = solve(rig, own, _options(free, _LOSS))
        best = found if best is None or found.cost < best.cost else best
    assert best is not None
    free[0, K1] = True
    best = solve(best.rig, own, _options(free, _LOSS))
    poses = _matrices(best.rig.body_rotations, best.rig.body_positions)
    return best.rig.lenses[0], dict(zip(frames.tolist(), poses, strict=True))


def _board_pose(rows: Sightings, lens: Float64s) -> Float64s:
    """(4, 4) the board in the axes of the one camera that saw it, without distortion."""
    cv2 = load_opencv()
    matrix = np.array([[lens[FOCAL], 0.0, lens[CENTER_X]], [0.0, lens[FOCAL], lens[CENTER_Y]], [0.0, 0.0, 1.0]])
    _, turns, shifts, _ = cv2.solvePnPGeneric(rows.places, rows.pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    rotation = cv2.Rodrigues(turns[0])[0]
    pose: Float64s = _matrices(rotation[None], np.asarray(shifts[0], np.float64).reshape(1, 3))[0]
    return pose


def _matrices(rotations: Float64s, shifts: Float64s) -> Float64s:
    """(N, 4, 4) rigid matrices."""
    matrices = np.tile(np.eye(4), (len(rotations), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = rotations, shifts
    return matrices


def _relative_poses(seen: _Seen, singles: Sequence[tuple[Float64s, dict[int, Float64s]]]) -> list[Float64s]:
    """(4, 4) world to camera for each, the first one's axes being the world's: along the frames that most share."""
    shared = {
        (one, other): sorted(set(singles[one][1]) & set(singles[other][1]))
        for one in range(len(singles))
        for other in range(len(singles))
        if one != other
    }
    poses: dict[int, Float64s] = {0: np.eye(4)}
    while len(poses) < len(singles):
        reachable = {pair: frames for pair, frames in shared.items() if pair[0] in poses and pair[1] not in poses}
        one, other = max(reachable, key=lambda pair: len(reachable[pair]))
        frames = reachable[one, other]
        if len(frames) < _LEAST_SHARED:
            raise CalibrationRefused(_not_together(seen.facts, sorted(set(range(len(singles))) - set(poses))))
        steps = np.stack([singles[other][1][frame] @ np.linalg.inv(singles[one][1][frame]) for frame in frames])
        step, scatter = _most_agreed(steps)
        if scatter > _MOST_SCATTER:
            raise CalibrationRefused(
                f"Cameras {seen.facts[one].name} and {seen.facts[other].name} disagree by {scatter:.0f} degrees on how "
                "the board turned: their films are not in step, or one of the cameras was moved; synchronise the "
                "films, and let the cameras stand still."
            )
        poses[other] = step @ poses[one]
    return [poses[camera] for camera in range(len(singles))]


def _not_together(facts: Sequence[CameraFacts], apart: Sequence[int]) -> str:
    names = ", ".join(facts[camera].name for camera in apart)
    return (
        f"No other camera sees the board at the same time as {names}: hold it where two cameras see it at once, for "
        "every neighbouring pair."
    )


def _most_agreed(steps: Float64s) -> tuple[Float64s, float]:
    """Of (N, 4, 4) poses the one that the others are nearest to in rotation, and their median angle to it, degrees.

    A board that is seen almost straight on has two poses that explain it; such frames disagree with the others.
    """
    rotations = steps[:, :3, :3]
    traces = np.einsum("aij,bij->ab", rotations, rotations)
    angles = np.degrees(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))
    scatter = np.median(angles, axis=1)
    best = int(np.argmin(scatter))
    return steps[best], float(scatter[best])


def _assembled(seen: _Seen, singles: Sequence[tuple[Float64s, dict[int, Float64s]]], poses: Sequence[Float64s]) -> Rig:
    """All cameras, and in each frame the board where the camera put it that the others agree with most."""
    placed = np.stack(poses)
    lenses = np.stack([lens for lens, _ in singles])
    cameras = np.arange(len(singles))
    boards = []
    for frame in range(seen.frames):
        rows = seen.sightings.where(seen.sightings.bodies == frame)
        rows = replace(rows, bodies=np.zeros(len(rows), dtype=np.int64))
        candidates = []
        for camera, (_, found) in enumerate(singles):
            if frame in found:
                pose = (np.linalg.inv(placed[camera]) @ found[frame])[None]
                rig = Rig(placed[:, :3, :3], placed[:, :3, 3], lenses, cameras, pose[:, :3, :3], pose[:, :3, 3])
                off = np.sum(rig.residuals(rows) ** 2, axis=1)
                candidates.append((float(np.log1p(off / _LOOSE_LOSS**2).sum()), camera, pose[0]))
        boards.append(min(candidates, key=lambda entry: entry[:2])[2])
    stacked = np.stack(boards)
    return Rig(placed[:, :3, :3], placed[:, :3, 3], lenses, cameras, stacked[:, :3, :3], stacked[:, :3, 3])


def _with_more_of_the_lenses(seen: _Seen, solution: Solution, free: Bools) -> Solution:
    """The solution with a second coefficient and the principal point freed in the cameras whose images say them.

    A lower residual alone says nothing: what is freed must predict frames that it has not seen, and leave its value
    hardly open.
    """
    kept = free
    before = _held_out_costs(seen, solution.rig, kept)
    for parameters in ([K2], [CENTER_X, CENTER_Y]):
        tried = kept.copy()
        tried[:, parameters] = True
        found = solve(solution.rig, seen.sightings, _options(tried, _LOSS))
        costs = _held_out_costs(seen, found.rig, tried)
        is_better = (costs < (1.0 - _GAIN) * before) & _is_certain(seen, found, parameters)
        if not is_better.any():
            continue
        kept = kept.copy()
        kept[np.ix_(is_better, np.array(parameters))] = True
        solution = solve(solution.rig, seen.sightings, _options(kept, _LOSS))
        before = _held_out_costs(seen, solution.rig, kept)
    return solution


def _held_out_costs(seen: _Seen, rig: Rig, free: Bools) -> Float64s:
    """(C,) cost of the frames that a solution without them leaves to each camera, the boards alone being fitted."""
    is_held_out = seen.sightings.bodies % _HELD_OUT == 0
    trained = solve(rig, seen.sightings.where(~is_held_out), _options(free, _LOSS)).rig
    rest = seen.sightings.where(is_held_out)
    fitted = solve(trained, rest, _options(np.zeros_like(free), _LOSS, holding=True)).rig
    costs = np.log1p(np.sum(fitted.residuals(rest) ** 2, axis=1) / _LOSS**2)
    summed: Float64s = np.bincount(rest.cameras, costs, minlength=len(seen.facts)).astype(np.float64)
    return summed


def _is_certain(seen: _Seen, solution: Solution, parameters: Sequence[int]) -> Bools:
    """(C,) whether what was freed is known well enough, at the image's corner too, where boards are seldom seen."""
    sides = np.array([camera.side for camera in seen.facts])
    lenses, sigmas = solution.rig.lenses, solution.lens_sigmas
    if CENTER_X in parameters:
        return np.asarray(sigmas[:, CENTER_X:].max(axis=1) < _CENTER_SIGMA * sides)
    radius = np.array([np.hypot(camera.width, camera.height) / 2 for camera in seen.facts]) / lenses[:, FOCAL]
    square = radius**2
    slope = 1.0 + 3.0 * lenses[:, K1] * square + 5.0 * lenses[:, K2] * square**2
    return np.asarray((sigmas[:, K2] * square**2 < _CORNER_SIGMA) & (slope > 0.2))


def _check(seen: _Seen, board: Board, solution: Solution) -> list[str]:
    """Refuses what does not hold together; the warnings where it hardly does."""
    warnings = []
    sightings = seen.sightings
    off = np.linalg.norm(solution.rig.residuals(sightings), axis=1)
    for index, camera in enumerate(seen.facts):
        sigma = float(solution.lens_sigmas[index, FOCAL])
        if not sigma < _MOST_SIGMA:
            raise CalibrationRefused(
                f"The focal length of camera {camera.name} stays uncertain by {100 * sigma:.0f} %: hold the board "
                "nearer and more tilted, in several directions."
            )
        residual = float(np.median(off[sightings.cameras == index]))
        if residual > _MOST_RESIDUAL * camera.side:
            raise CalibrationRefused(
                f"The corners that camera {camera.name} sees lie {residual:.1f} pixels from where {board} would put "
                "them: the films are not in step, the lens is a fisheye's, or the board is not flat or not this one."
            )
        if residual > _DOUBTFUL_RESIDUAL * camera.side:
            warnings.append(
                f"The corners that camera {camera.name} sees lie {residual:.1f} pixels from where they should: its "
                "film may be a little out of step with the others."
            )
    return warnings
