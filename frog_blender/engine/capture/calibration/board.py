"""Cameras from a calibration board that their films show: lenses, poses, and the metric scale from its squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float64s, ImageArray
from ..synchronization.films import Film
from ..synchronization.run import CalibrationRefused, Run
from ..video import load_opencv
from . import limits
from .board_detection import Board, Corners, find_board, find_corners
from .board_rig import BoardRig, Corners3D, adjust_rig
from .calibration import Calibration
from .colmap import Adjusted
from .model import Lens, Model
from .support import calibration_of, camera_support
from .tracks import Tracks
from .views import CameraFacts, images_at

TIMES = 60
"""Common times at which the board is looked at: more of them cost time and win little."""
_IMAGES = 24  # of all films together, in which an unknown board is looked for
_FIRST_FOCALS = (0.45, 0.7, 1.0, 1.5, 2.4)  # of the longer side
_FIRST_IMAGES, _LEAST_CORNERS = 8, 4  # for these, and of an image
_LOSS = 2.0  # pixels
_LOOSE_LOSS = 20.0  # pixels, before the poses of all cameras fit together
_HELD_OUT = 3  # every third frame


def board_in_films(films: Sequence[Film], times: Sequence[float], check: Callable[[], None]) -> Board | None:
    """The board that the films show at capture times in seconds, of unknown size; None where they show none."""
    images: list[ImageArray] = []
    share = max(3, _IMAGES // len(films))
    for film in films:
        chosen = np.unique(np.linspace(0, len(times) - 1, min(share, len(times))).round().astype(int)).tolist()
        images += [image for image in images_at(film, [times[index] for index in chosen], check) if image is not None]
    return find_board(images)


def corners_in_films(
    run: Run, films: Sequence[Film], times: Sequence[float], board: Board
) -> list[list[Corners | None]]:
    """What each film shows of a board at common capture times in seconds; FrogError if one cannot be decoded."""
    corners: list[list[Corners | None]] = []
    for index, film in enumerate(films):
        run.progress("board", index, len(films))
        corners.append(list(find_corners(board, images_at(film, times, run.check))))
    return corners


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
    for camera, found in zip(facts, corners, strict=True):
        count = sum(shown is not None for shown in found)
        if count < limits.BOARD_IMAGES:
            raise CalibrationRefused(
                f"Camera {camera.name} shows the board in {count} of {len(found)} images, expected "
                f"{limits.BOARD_IMAGES} or more: move the board through what each camera sees, tilted, slowly, and "
                "near enough to fill a quarter of its image."
            )
    seen = _seen(board, corners)
    singles = [_single_camera(camera, seen.where(seen.cameras == index)) for index, camera in enumerate(facts)]
    rig = _assembled(tuple(facts), seen, singles, _relative_poses(facts, seen, singles))
    one = (1,) * len(facts)
    rig = adjust_rig(adjust_rig(rig, seen, (), _LOOSE_LOSS), seen, one, _LOSS)
    # A lower residual alone says nothing: what is freed must predict frames that it has not seen.
    two = (2,) * len(facts)
    is_better = _held_out_costs(rig, seen, two) < (1.0 - limits.BOARD_GAINS) * _held_out_costs(rig, seen, one)
    is_better &= _is_possible(adjust_rig(rig, seen, two, _LOSS))
    if is_better.any():
        rig = adjust_rig(rig, seen, tuple(np.where(is_better, 2, 1).tolist()), _LOSS)
    sigmas = np.array([single.sigma for single in singles])
    warnings = _checked(rig, seen, board, sigmas)
    if not board.square:
        warnings.append(f"The size of the squares of {board} is not given: the rig's scale is arbitrary.")
    return replace(_calibration(rig, seen, sigmas, is_metric=board.square is not None), warnings=tuple(warnings))


def _seen(board: Board, corners: Sequence[Sequence[Corners | None]]) -> Corners3D:
    """All corners; a frame in which nobody saw the board is left out."""
    frames = [time for time in range(len(corners[0])) if any(found[time] is not None for found in corners)]
    shown = [
        (camera, frame, image)
        for camera, found in enumerate(corners)
        for frame, time in enumerate(frames)
        if (image := found[time]) is not None
    ]
    counts = [len(image.numbers) for _, _, image in shown]
    return Corners3D(
        np.repeat([camera for camera, _, _ in shown], counts),
        np.repeat([frame for _, frame, _ in shown], counts),
        np.concatenate([board.places[image.numbers] for _, _, image in shown]),
        np.concatenate([image.pixels for _, _, image in shown]),
    )


@dataclass(frozen=True, eq=False)
class _Single:
    """A camera by itself: its lens (3,) as of ``BoardRig``, the boards (F, 4, 4) in its axes, and the standard
    deviation of its focal length, over it."""

    lens: Float64s
    boards: Float64s
    sigma: float


def _single_camera(facts: CameraFacts, seen: Corners3D) -> _Single:
    """By OpenCV: of several focal lengths the best for some of the images, then of all; and without false corners."""
    boards = np.tile(np.eye(4), (int(seen.frames.max()) + 1, 1, 1))
    widest = np.argsort(-np.bincount(seen.frames), kind="stable")[:_FIRST_IMAGES]
    some = seen.where(np.isin(seen.frames, widest))
    focal = min(_opencv_camera(facts, some, ratio * facts.side)[:2] for ratio in _FIRST_FOCALS)[1]
    while True:
        _, focal, k1, sigma, poses = _opencv_camera(facts, seen, focal)
        boards[np.unique(seen.frames)] = poses
        lens = np.array([focal, k1, 0.0])
        alone = BoardRig((facts,), lens[None], np.eye(4)[None], boards)
        is_false = alone.distances(replace(seen, cameras=np.zeros_like(seen.cameras))) > limits.BOARD_FALSE * facts.side
        good = seen.where(~is_false)
        good = good.where(np.bincount(good.frames)[good.frames] >= _LEAST_CORNERS)
        if not is_false.any() or len(np.unique(good.frames)) < limits.BOARD_SHARED:
            return _Single(lens, boards, sigma)
        seen = good


def _opencv_camera(facts: CameraFacts, seen: Corners3D, focal: float) -> tuple[float, float, float, float, Float64s]:
    """From a focal length to start with: the residual, the focal length, k1, the focal length's relative standard
    deviation, and the board's poses (F, 4, 4) in the camera's axes."""
    cv2 = load_opencv()
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT
    flags |= cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 1e-6)
    parts = [seen.where(seen.frames == frame) for frame in np.unique(seen.frames).tolist()]
    corners = [[getattr(part, name).astype(np.float32) for part in parts] for name in ("places", "pixels")]
    matrix = np.array([[focal, 0, facts.width / 2], [0, focal, facts.height / 2], [0, 0, 1.0]])
    residual, matrix, bent, turns, shifts = cv2.calibrateCamera(
        *corners, facts.size, matrix, np.zeros(4), flags=flags, criteria=stop
    )
    poses, curvature = np.tile(np.eye(4), (len(parts), 1, 1)), np.zeros((2, 2))
    for pose, places, turn, shift in zip(poses, corners[0], turns, shifts, strict=True):
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], np.asarray(shift).reshape(3)
        # What the board's own pose cannot do in place of the lens; OpenCV's own deviations hide what is left open.
        by_all = cv2.projectPoints(places, turn, shift, matrix, bent)[1]
        by_lens = np.column_stack([by_all[:, 6] + by_all[:, 7], by_all[:, 10]])
        by_lens -= by_all[:, :6] @ np.linalg.lstsq(by_all[:, :6], by_lens, rcond=None)[0]
        curvature += by_lens.T @ by_lens
    variance = residual**2 / 2 * np.linalg.inv(curvature + 1e-12 * np.eye(2))[0, 0]
    sigma = float(np.sqrt(variance) / matrix[0, 0]) if variance > 0 else np.inf
    return float(residual), float(matrix[0, 0]), float(bent.reshape(-1)[0]), sigma, poses


def _cost(rig: BoardRig, seen: Corners3D, loss: float) -> float:
    return float(np.log1p((rig.distances(seen) / loss) ** 2).sum())


def _relative_poses(facts: Sequence[CameraFacts], seen: Corners3D, singles: Sequence[_Single]) -> Float64s:
    """(C, 4, 4) world to camera, the first one's axes being the world's: along the frames that most share."""
    frames_of = [set(seen.frames[seen.cameras == camera].tolist()) for camera in range(len(facts))]
    poses: dict[int, Float64s] = {0: np.eye(4)}
    while len(poses) < len(facts):
        reachable = [(one, other) for one in poses for other in range(len(facts)) if other not in poses]
        one, other = max(reachable, key=lambda pair: len(frames_of[pair[0]] & frames_of[pair[1]]))
        frames = sorted(frames_of[one] & frames_of[other])
        if len(frames) < limits.BOARD_SHARED:
            names = ", ".join(camera.name for index, camera in enumerate(facts) if index not in poses)
            raise CalibrationRefused(
                f"No other camera sees the board at the same time as {names}: hold it where two cameras see it at "
                "once, for every neighbouring pair."
            )
        step, scatter = _most_agreed(singles[other].boards[frames] @ np.linalg.inv(singles[one].boards[frames]))
        if scatter > limits.BOARD_SCATTER:
            raise CalibrationRefused(
                f"Cameras {facts[one].name} and {facts[other].name} disagree by {scatter:.0f} degrees on how the board "
                "turned: their films are not in step, or one of the cameras was moved; synchronise the films, and let "
                "the cameras stand still."
            )
        poses[other] = step @ poses[one]
    return np.stack([poses[camera] for camera in range(len(facts))])


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


def _assembled(
    facts: tuple[CameraFacts, ...], seen: Corners3D, singles: Sequence[_Single], poses: Float64s
) -> BoardRig:
    """All cameras, and in each frame the board where the camera put it that the others agree with most."""
    lenses = np.stack([single.lens for single in singles])
    rig = BoardRig(facts, lenses, poses, singles[0].boards.copy())
    boards = np.tile(np.eye(4), (int(seen.frames.max()) + 1, 1, 1))
    for frame in range(len(boards)):
        rows = seen.where(seen.frames == frame)
        placed = []
        for camera in np.unique(rows.cameras).tolist():
            tried = boards.copy()
            tried[frame] = np.linalg.inv(poses[camera]) @ singles[camera].boards[frame]
            placed.append((_cost(replace(rig, boards=tried), rows, _LOOSE_LOSS), camera, tried))
        boards = min(placed, key=lambda entry: entry[:2])[2]
    return replace(rig, boards=boards)


def _held_out_costs(rig: BoardRig, seen: Corners3D, coefficients: tuple[int, ...]) -> Float64s:
    """(C,) cost of the frames that a solution without them leaves to each camera, the boards alone being fitted."""
    is_held_out: Bools = seen.frames % _HELD_OUT == 0
    trained = adjust_rig(rig, seen.where(~is_held_out), coefficients, _LOSS)
    rest = seen.where(is_held_out)
    fitted = adjust_rig(trained, rest, (), _LOSS, poses=False)
    costs = np.log1p((fitted.distances(rest) / _LOSS) ** 2)
    return np.bincount(rest.cameras, costs, minlength=len(rig.facts)).astype(np.float64)


def _is_possible(rig: BoardRig) -> Bools:
    """(C,) whether a lens still grows outwards at its image's corner, where boards are seldom seen."""
    focal, k1, k2 = rig.lenses.T
    square = np.array([camera.width**2 + camera.height**2 for camera in rig.facts]) / (2 * focal) ** 2
    return np.asarray(1.0 + 3.0 * k1 * square + 5.0 * k2 * square**2 > limits.BOARD_SLOPE)


def _checked(rig: BoardRig, seen: Corners3D, board: Board, sigmas: Float64s) -> list[str]:
    """Refuses what does not hold together; the warnings where it hardly does."""
    warnings, distances = [], rig.distances(seen)
    for index, (camera, sigma) in enumerate(zip(rig.facts, sigmas.tolist(), strict=True)):
        if not sigma < limits.MOST_UNSURE:
            raise CalibrationRefused(
                f"The focal length of camera {camera.name} stays uncertain by {100 * sigma:.0f} %: hold the board "
                "nearer and more tilted, in several directions."
            )
        residual = float(np.median(distances[seen.cameras == index]))
        if residual > limits.BOARD_RESIDUAL * camera.side:
            raise CalibrationRefused(
                f"The corners that camera {camera.name} sees lie {residual:.1f} pixels from where {board} would put "
                "them: the films are not in step, the lens is a fisheye's, or the board is not flat or not this one."
            )
        if residual > limits.DOUBTFUL_BOARD_RESIDUAL * camera.side:
            warnings.append(
                f"The corners that camera {camera.name} sees lie {residual:.1f} pixels from where they should: its "
                "film may be a little out of step with the others."
            )
    return warnings


def _calibration(rig: BoardRig, seen: Corners3D, sigmas: Float64s, *, is_metric: bool) -> Calibration:
    """The rig in its world, with what supports each camera."""
    boards = rig.boards[seen.frames]
    places = np.einsum("mij,mj->mi", boards[:, :3, :3], seen.places) + boards[:, :3, 3]
    corners = np.column_stack([seen.frames, seen.places])
    _, first, point_of = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(point_of.reshape(-1), kind="stable")
    tracks = Tracks(point_of.reshape(-1)[order], seen.cameras[order], order, seen.pixels[order], len(first))
    lenses = tuple(
        Lens(*facts.size, focal, k1, k2, limits.BOARD_FALSE * facts.side / facts.width)
        for facts, (focal, k1, k2) in zip(rig.facts, rig.lenses.tolist(), strict=True)
    )
    adjusted = Adjusted(Model(rig.cameras[:, :3], lenses), places[first], rig.distances(seen)[order], sigmas)
    supports = camera_support(adjusted, tracks, len(lenses))
    return calibration_of([facts.name for facts in rig.facts], adjusted, tracks, supports, is_metric=is_metric)
