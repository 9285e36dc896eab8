"""Cameras from a calibration board that their films show: lenses, poses, and the metric scale from its squares."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...arrays import Bools, Float64s, ImageArray
from ...io.child_process import Progress
from ..readers.footage import decode_film
from ..video import load_opencv
from .board_detection import Board, Corners, find_board, find_corners
from .board_rig import CENTER_X, CENTER_Y, FOCAL, K1, K2, BoardRig, Corners3D, Freedom, adjust_rig
from .calibration import Calibration, CalibrationRefused
from .checks import BOARD_RESIDUAL, DOUBTFUL_BOARD_RESIDUAL, MOST_UNSURE
from .colmap import Adjusted
from .films import Film
from .model import Lens, Model
from .points import CameraFacts
from .support import calibration_of, camera_support
from .tracks import Tracks

TIMES = 60
"""Common times at which the board is looked at: more of them cost time and win little."""
_IMAGES = 24  # of all films together, in which an unknown board is looked for
_FIRST_FOCALS = (0.45, 0.7, 1.0, 1.5, 2.4)  # of the longer side
_LOSS = 2.0  # pixels
_LOOSE_LOSS = 20.0  # pixels, before the poses of all cameras fit together
_LEAST_IMAGES = 5  # that show the board, of each camera
_LEAST_SHARED = 3  # frames in which two cameras saw the board at once
_MOST_SCATTER = 15.0  # degrees by which half the frames may disagree on how two cameras stand
_FALSE = 0.008  # of the longer side: a corner that is farther off is another one
_GAIN = 0.02  # by which the held-out cost must fall for one more lens parameter
_CORNER_SIGMA = 0.01  # of the distance from the middle, at the image's corner: the most a coefficient may leave open
_CENTER_SIGMA = 0.001  # of the longer side
_HELD_OUT = 3  # every third frame


def board_in_films(films: Sequence[Film], times: Sequence[float], cancelled: Callable[[], None]) -> Board | None:
    """The board that the films show at capture times in seconds, of unknown size; None where they show none."""
    images: list[ImageArray] = []
    share = max(3, _IMAGES // len(films))
    for film in films:
        chosen = np.unique(np.linspace(0, len(times) - 1, min(share, len(times))).round().astype(int)).tolist()
        images += [
            image for image in images_at(film, [times[index] for index in chosen], cancelled) if image is not None
        ]
    return find_board(images)


def corners_in_films(
    films: Sequence[Film], times: Sequence[float], board: Board, progress: Progress, cancelled: Callable[[], None]
) -> list[list[Corners | None]]:
    """What each film shows of a board at common capture times in seconds.

    Args:
        cancelled: called before each image; it raises what ends the work.

    Raises:
        FrogError: for a film that cannot be decoded.
    """
    corners: list[list[Corners | None]] = []
    for index, film in enumerate(films):
        progress("board", index, len(films))
        corners.append(list(find_corners(board, images_at(film, times, cancelled))))
    return corners


def images_at(film: Film, times: Sequence[float], cancelled: Callable[[], None]) -> Iterator[ImageArray | None]:
    """The images nearest to ascending capture times; None where the film has none."""
    frames = [round(film.frame_at(time)) for time in times]
    needed = sorted({frame for frame in frames if 0 <= frame < film.facts.frame_count})
    decoded = decode_film(film.path, needed)
    last, image = -1, None
    for frame in frames:
        cancelled()
        if not 0 <= frame < film.facts.frame_count:
            yield None
            continue
        if frame != last:
            last, image = frame, next(decoded)
        yield image


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
    seen = _seen(board, corners)
    singles = [_single_camera(camera, seen.where(seen.cameras == index)) for index, camera in enumerate(facts)]
    rig = _assembled(tuple(facts), seen, singles, _relative_poses(facts, seen, singles))
    rig = adjust_rig(rig, seen, Freedom(), _LOOSE_LOSS)
    rig = _with_more_of_the_lenses(adjust_rig(rig, seen, Freedom((1,) * len(facts)), _LOSS), seen)
    warnings = _checked(rig, seen, board)
    if not board.square:
        warnings.append(f"The size of the squares of {board} is not given: the rig's scale is arbitrary.")
    return replace(_calibration(rig, seen, is_metric=board.square is not None), warnings=tuple(warnings))


def _check_counts(facts: Sequence[CameraFacts], corners: Sequence[Sequence[Corners | None]]) -> None:
    for camera, found in zip(facts, corners, strict=True):
        count = sum(shown is not None for shown in found)
        if count < _LEAST_IMAGES:
            raise CalibrationRefused(
                f"Camera {camera.name} shows the board in {count} of {len(found)} images, expected {_LEAST_IMAGES} "
                "or more: move the board through what each camera sees, tilted, slowly, and near enough to fill a "
                "quarter of its image."
            )


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


def _single_camera(facts: CameraFacts, seen: Corners3D) -> BoardRig:
    """A camera by itself: the board's poses are those in its axes."""
    own = replace(seen, cameras=np.zeros_like(seen.cameras))
    found = []
    for ratio in _FIRST_FOCALS:
        lens = np.array([[ratio * facts.side, 0.0, 0.0, facts.width / 2, facts.height / 2]])
        boards = np.tile(np.eye(4), (int(own.frames.max()) + 1, 1, 1))
        for frame in np.unique(own.frames).tolist():
            boards[frame] = _board_pose(own.where(own.frames == frame), lens[0])
        start = BoardRig((facts,), lens, np.eye(4)[None], boards, np.zeros((1, 5)))
        rig = adjust_rig(start, own, Freedom((0,)), _LOSS)
        found.append((_cost(rig, own, _LOSS), ratio, rig))
    return adjust_rig(min(found, key=lambda entry: entry[:2])[2], own, Freedom((1,)), _LOSS)


def _cost(rig: BoardRig, seen: Corners3D, loss: float) -> float:
    return float(np.log1p((rig.distances(seen) / loss) ** 2).sum())


def _board_pose(rows: Corners3D, lens: Float64s) -> Float64s:
    """(4, 4) the board in the axes of the one camera that saw it, without distortion."""
    cv2 = load_opencv()
    matrix = np.array([[lens[FOCAL], 0.0, lens[CENTER_X]], [0.0, lens[FOCAL], lens[CENTER_Y]], [0.0, 0.0, 1.0]])
    _, turns, shifts, _ = cv2.solvePnPGeneric(rows.places, rows.pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turns[0])[0], np.asarray(shifts[0]).reshape(3)
    return pose


def _relative_poses(facts: Sequence[CameraFacts], seen: Corners3D, singles: Sequence[BoardRig]) -> Float64s:
    """(C, 4, 4) world to camera, the first one's axes being the world's: along the frames that most share."""
    frames_of = [set(seen.frames[seen.cameras == camera].tolist()) for camera in range(len(facts))]
    poses: dict[int, Float64s] = {0: np.eye(4)}
    while len(poses) < len(facts):
        reachable = [(one, other) for one in poses for other in range(len(facts)) if other not in poses]
        one, other = max(reachable, key=lambda pair: len(frames_of[pair[0]] & frames_of[pair[1]]))
        frames = sorted(frames_of[one] & frames_of[other])
        if len(frames) < _LEAST_SHARED:
            names = ", ".join(camera.name for index, camera in enumerate(facts) if index not in poses)
            raise CalibrationRefused(
                f"No other camera sees the board at the same time as {names}: hold it where two cameras see it at "
                "once, for every neighbouring pair."
            )
        step, scatter = _most_agreed(singles[other].boards[frames] @ np.linalg.inv(singles[one].boards[frames]))
        if scatter > _MOST_SCATTER:
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
    facts: tuple[CameraFacts, ...], seen: Corners3D, singles: Sequence[BoardRig], poses: Float64s
) -> BoardRig:
    """All cameras, and in each frame the board where the camera put it that the others agree with most."""
    lenses = np.concatenate([single.lenses for single in singles])
    frames = int(seen.frames.max()) + 1
    rig = BoardRig(facts, lenses, poses, np.tile(np.eye(4), (frames, 1, 1)), np.zeros((len(facts), 5)))
    for frame in range(frames):
        rows = seen.where(seen.frames == frame)
        placed = []
        for camera in np.unique(rows.cameras).tolist():
            boards = rig.boards.copy()
            boards[frame] = np.linalg.inv(poses[camera]) @ singles[camera].boards[frame]
            candidate = replace(rig, boards=boards)
            placed.append((_cost(candidate, rows, _LOOSE_LOSS), camera, candidate))
        rig = min(placed, key=lambda entry: entry[:2])[2]
    return rig


def _with_more_of_the_lenses(rig: BoardRig, seen: Corners3D) -> BoardRig:
    """The rig with second coefficients, then with principal points, where its images say them.

    A lower residual alone says nothing: what is freed must predict frames that it has not seen, and leave its value
    hardly open. Each camera has its own second coefficient; the principal points of all are freed together.
    """
    free = Freedom((1,) * len(rig.facts))
    before = _held_out_costs(rig, seen, free)
    more = replace(free, coefficients=(2,) * len(rig.facts))
    found = adjust_rig(rig, seen, more, _LOSS)
    is_better = (_held_out_costs(found, seen, more) < (1.0 - _GAIN) * before) & _is_certain(found)
    if is_better.any():
        free = replace(free, coefficients=tuple(np.where(is_better, 2, 1).tolist()))
        rig = adjust_rig(rig, seen, free, _LOSS)
        before = _held_out_costs(rig, seen, free)
    more = replace(free, centers=True)
    found = adjust_rig(rig, seen, more, _LOSS)
    sides = np.array([camera.side for camera in rig.facts])
    is_sure = (found.sigmas[:, CENTER_X:].max(axis=1) < _CENTER_SIGMA * sides).all()
    return found if is_sure and _held_out_costs(found, seen, more).sum() < (1.0 - _GAIN) * before.sum() else rig


def _held_out_costs(rig: BoardRig, seen: Corners3D, free: Freedom) -> Float64s:
    """(C,) cost of the frames that a solution without them leaves to each camera, the boards alone being fitted."""
    is_held_out = seen.frames % _HELD_OUT == 0
    trained = adjust_rig(rig, seen.where(~is_held_out), free, _LOSS)
    rest = seen.where(is_held_out)
    fitted = adjust_rig(trained, rest, Freedom(poses=False), _LOSS)
    costs = np.log1p((fitted.distances(rest) / _LOSS) ** 2)
    return np.bincount(rest.cameras, costs, minlength=len(rig.facts)).astype(np.float64)


def _is_certain(rig: BoardRig) -> Bools:
    """(C,) whether k2 is known well enough at the image's corner, where boards are seldom seen."""
    radius = np.array([np.hypot(camera.width, camera.height) / 2 for camera in rig.facts]) / rig.lenses[:, FOCAL]
    square = radius**2
    slope = 1.0 + 3.0 * rig.lenses[:, K1] * square + 5.0 * rig.lenses[:, K2] * square**2
    return np.asarray((rig.sigmas[:, K2] * square**2 < _CORNER_SIGMA) & (slope > 0.2))


def _checked(rig: BoardRig, seen: Corners3D, board: Board) -> list[str]:
    """Refuses what does not hold together; the warnings where it hardly does."""
    warnings, distances = [], rig.distances(seen)
    for index, camera in enumerate(rig.facts):
        sigma = float(rig.sigmas[index, FOCAL])
        if not sigma < MOST_UNSURE:
            raise CalibrationRefused(
                f"The focal length of camera {camera.name} stays uncertain by {100 * sigma:.0f} %: hold the board "
                "nearer and more tilted, in several directions."
            )
        residual = float(np.median(distances[seen.cameras == index]))
        if residual > BOARD_RESIDUAL * camera.side:
            raise CalibrationRefused(
                f"The corners that camera {camera.name} sees lie {residual:.1f} pixels from where {board} would put "
                "them: the films are not in step, the lens is a fisheye's, or the board is not flat or not this one."
            )
        if residual > DOUBTFUL_BOARD_RESIDUAL * camera.side:
            warnings.append(
                f"The corners that camera {camera.name} sees lie {residual:.1f} pixels from where they should: its "
                "film may be a little out of step with the others."
            )
    return warnings


def _calibration(rig: BoardRig, seen: Corners3D, *, is_metric: bool) -> Calibration:
    """The rig in its world, with what supports each camera."""
    boards = rig.boards[seen.frames]
    places = np.einsum("mij,mj->mi", boards[:, :3, :3], seen.places) + boards[:, :3, 3]
    corners = np.column_stack([seen.frames, seen.places])
    _, first, point_of = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(point_of.reshape(-1), kind="stable")
    tracks = Tracks(point_of.reshape(-1)[order], seen.cameras[order], order, seen.pixels[order], len(first))
    lenses = tuple(
        Lens(facts.width, facts.height, lens[FOCAL], lens[K1], lens[K2], _FALSE * facts.side / facts.width)
        for facts, lens in zip(rig.facts, rig.lenses.tolist(), strict=True)
    )
    model = Model(rig.cameras[:, :3], lenses)
    adjusted = Adjusted(model, places[first], rig.distances(seen)[order], rig.sigmas[:, FOCAL])
    supports = camera_support(adjusted, tracks, np.full(len(lenses), np.nan))
    names = [facts.name for facts in rig.facts]
    found = calibration_of(names, adjusted, tracks, supports, is_metric=is_metric)
    cameras = []
    for camera, lens in zip(found.cameras, rig.lenses, strict=True):
        intrinsics = camera.camera.intrinsics.copy()
        intrinsics[:2, 2] = lens[[CENTER_X, CENTER_Y]]
        cameras.append(replace(camera, camera=replace(camera.camera, intrinsics=intrinsics)))
    return replace(found, cameras=tuple(cameras))
