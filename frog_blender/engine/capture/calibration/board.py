"""Cameras from a calibration board that their films show: lenses, poses, and the metric scale from its squares.

COLMAP adjusts them. Seen from the board, the cameras are a rig that moves: the board's corners stay where they are,
each common time is a pose of the rig, and the cameras stand within it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..readers.geometry import intrinsics
from ..synchronization.films import CalibrationRefused, Film, Run, spread
from ..video import load_opencv
from . import limits
from .board_detection import Board, Corners, find_board, find_corners
from .checks import calibration_of
from .colmap import Adjusted, adjustment_options, colmap_camera, load_pycolmap
from .model import Calibration, Lens, Model, Tracks, residuals
from .views import CameraFacts, common_times, facts_of, images_at

_TIMES = 60  # common ones at which the board is looked at: more of them cost time and win little
_IMAGES = 24  # of all films together, in which an unknown board is looked for
_FIRST_FOCALS = (0.45, 0.7, 1.0, 1.5, 2.4)  # of the longer side
_FIRST_IMAGES, _LEAST_CORNERS = 8, 4  # for these, and of an image
_LOSS = 2.0  # pixels
_LOOSE_LOSS = 20.0  # pixels, before the poses of all cameras fit together
_HELD_OUT = 3  # every third frame
_BEHIND = 1e3  # pixels of residual of a point behind its camera, the largest of any
_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class Corners3D:
    """Who saw which corner when, M rows.

    Attributes:
        cameras, frames: (M,) index of the camera, and of the common time.
        places: (M, 3) the corner in the board's own axes.
        pixels: (M, 2) where it was seen.
    """

    cameras: Ints
    frames: Ints
    places: Float64s
    pixels: Float64s

    def where(self, chosen: Bools) -> Corners3D:
        """The chosen rows; frames keep their numbers."""
        return Corners3D(self.cameras[chosen], self.frames[chosen], self.places[chosen], self.pixels[chosen])


@dataclass(frozen=True, eq=False)
class BoardRig:
    """What is solved for.

    Attributes:
        model: the cameras; the first one's axes are the world's.
        boards: (F, 4, 4) board to world at each common time.
    """

    model: Model
    boards: Float64s

    def world(self, seen: Corners3D) -> Float64s:
        """(M, 3) where the corners are in the world."""
        boards = self.boards[seen.frames]
        return np.asarray(np.einsum("mij,mj->mi", boards[:, :3, :3], seen.places) + boards[:, :3, 3])

    def distances(self, seen: Corners3D) -> Float64s:
        """(M,) pixels between where corners were seen and where the rig puts them."""
        rows = np.arange(len(seen.frames))
        tracks = Tracks(rows, seen.cameras, rows, seen.pixels, len(rows))
        return np.minimum(residuals(tracks, self.world(seen), self.model), _BEHIND)


def board_in_films(run: Run, films: Sequence[Film]) -> Board | None:
    """The board that the films show, of unknown size; None where they show none."""
    run.progress("board", 0, 1)
    times = common_times(films, _TIMES)
    times = [times[index] for index in spread(len(times), max(3, _IMAGES // len(films)))]
    shown = (image for film in films for image in images_at(film, times, run.check))
    return find_board([image for image in shown if image is not None])


def calibrate_board_films(run: Run, board: Board, films: Sequence[Film], _count: int) -> Calibration:
    """The cameras of films that show a board; see ``calibrate_board``. FrogError if a film cannot be decoded."""
    times, corners = common_times(films, _TIMES), []
    for index, film in enumerate(films):
        run.progress("board", index, len(films))
        corners.append(list(find_corners(board, images_at(film, times, run.check))))
    return run.in_child(calibrate_board, facts_of(films), board, corners)


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
    for camera, of_camera in zip(facts, corners, strict=True):
        count = sum(shown is not None for shown in of_camera)
        if count < limits.BOARD_IMAGES:
            raise CalibrationRefused(
                f"Camera {camera.name} shows the board in {count} of {len(of_camera)} images, expected "
                f"{limits.BOARD_IMAGES} or more: move the board through what each camera sees, tilted, slowly, and "
                "near enough to fill a quarter of its image."
            )
    seen = _seen(board, corners)
    alone = [_single_camera(camera, seen.where(seen.cameras == index)) for index, camera in enumerate(facts)]
    singles, sigmas = [single for single, _ in alone], np.array([sigma for _, sigma in alone])
    rig = _assembled(seen, singles, _relative_poses(facts, seen, singles))
    one = (1,) * len(facts)
    rig = adjust_rig(adjust_rig(rig, seen, (), _LOOSE_LOSS), seen, one, _LOSS)
    # A lower residual alone says nothing: what is freed must predict frames that it has not seen.
    two = (2,) * len(facts)
    is_better = _held_out_costs(rig, seen, two) < (1.0 - limits.BOARD_GAINS) * _held_out_costs(rig, seen, one)
    is_better &= [_is_possible(lens) for lens in adjust_rig(rig, seen, two, _LOSS).model.lenses]
    if is_better.any():
        rig = adjust_rig(rig, seen, tuple(np.where(is_better, 2, 1).tolist()), _LOSS)
    warnings = _checked(facts, rig.distances(seen), seen, board, sigmas)
    if not board.square:
        warnings.append(f"The size of the squares of {board} is not given: the rig's scale is arbitrary.")
    names = [camera.name for camera in facts]
    calibration = calibration_of(names, _adjusted(rig, seen, sigmas), is_metric=board.square is not None)
    return replace(calibration, warnings=tuple(warnings))


def _seen(board: Board, corners: Sequence[Sequence[Corners | None]]) -> Corners3D:
    """All corners; a frame in which nobody saw the board is left out."""
    shown = [
        (camera, time, image)
        for camera, of_camera in enumerate(corners)
        for time, image in enumerate(of_camera)
        if image is not None
    ]
    cameras, times, images = zip(*shown, strict=True)
    counts = [len(image.numbers) for image in images]
    return Corners3D(
        np.repeat(cameras, counts),
        np.repeat(np.unique(times, return_inverse=True)[1], counts),
        np.concatenate([board.places[image.numbers] for image in images]),
        np.concatenate([image.pixels for image in images]),
    )


def _single_camera(facts: CameraFacts, seen: Corners3D) -> tuple[BoardRig, float]:
    """A camera by itself, whose axes are the world's, and the standard deviation of its focal length, over it.

    By OpenCV: of several focal lengths the best for some of the images, then of all; and without false corners.
    """
    seen = replace(seen, cameras=np.zeros_like(seen.cameras))
    boards = np.tile(np.eye(4), (int(seen.frames.max()) + 1, 1, 1))
    widest = np.argsort(-np.bincount(seen.frames), kind="stable")[:_FIRST_IMAGES]
    some = seen.where(np.isin(seen.frames, widest))
    tried = (_opencv_camera(facts, some, ratio * facts.side) for ratio in _FIRST_FOCALS)
    _, lens, _, _ = min(tried, key=lambda camera: camera[0])
    while True:
        _, lens, sigma, boards[np.unique(seen.frames)] = _opencv_camera(facts, seen, lens.focal)
        alone = BoardRig(Model(np.eye(4)[None, :3], (lens,)), boards)
        is_false = alone.distances(seen) > limits.BOARD_FALSE * facts.side
        good = seen.where(~is_false)
        good = good.where(np.bincount(good.frames)[good.frames] >= _LEAST_CORNERS)
        if not is_false.any() or len(np.unique(good.frames)) < limits.BOARD_SHARED:
            return alone, sigma
        seen = good


def _opencv_camera(facts: CameraFacts, seen: Corners3D, focal: float) -> tuple[float, Lens, float, Float64s]:
    """From a focal length to start with: the residual, the lens with k1, its focal length's relative deviation (sigma),
    and the board's poses (F, 4, 4) in the camera's axes."""
    cv2 = load_opencv()
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT
    flags |= cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 1e-6)
    parts = [seen.where(seen.frames == frame) for frame in np.unique(seen.frames).tolist()]
    corners = [[getattr(part, name).astype(np.float32) for part in parts] for name in ("places", "pixels")]
    matrix = intrinsics(focal, focal, facts.width / 2, facts.height / 2)
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
    tolerance = limits.BOARD_FALSE * facts.side / facts.width
    lens = Lens(*facts.size, float(matrix[0, 0]), float(bent.reshape(-1)[0]), tolerance=tolerance)
    return float(residual), lens, sigma, poses


def _costs(rig: BoardRig, seen: Corners3D, loss: float) -> Float64s:
    """(M,) Cauchy's."""
    return np.asarray(np.log1p((rig.distances(seen) / loss) ** 2))


def _relative_poses(facts: Sequence[CameraFacts], seen: Corners3D, singles: Sequence[BoardRig]) -> Float64s:
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
                "turned: their films are not in step, or one of the cameras was moved; synchronize the films, and let "
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


def _assembled(seen: Corners3D, singles: Sequence[BoardRig], poses: Float64s) -> BoardRig:
    """All cameras, and in each frame the board where the camera put it that the others agree with most."""
    model = Model(poses[:, :3], tuple(single.model.lenses[0] for single in singles))
    boards = np.tile(np.eye(4), (int(seen.frames.max()) + 1, 1, 1))
    for frame in range(len(boards)):
        rows = seen.where(seen.frames == frame)
        placed = []
        for camera in np.unique(rows.cameras).tolist():
            tried = boards.copy()
            tried[frame] = np.linalg.inv(poses[camera]) @ singles[camera].boards[frame]
            placed.append((_costs(BoardRig(model, tried), rows, _LOOSE_LOSS).sum(), camera, tried))
        boards = min(placed, key=lambda entry: entry[:2])[2]
    return BoardRig(model, boards)


def _held_out_costs(rig: BoardRig, seen: Corners3D, coefficients: tuple[int, ...]) -> Float64s:
    """(C,) cost of the frames that a solution without them leaves to each camera, the boards alone being fitted."""
    is_held_out: Bools = seen.frames % _HELD_OUT == 0
    trained = adjust_rig(rig, seen.where(~is_held_out), coefficients, _LOSS)
    rest = seen.where(is_held_out)
    fitted = adjust_rig(trained, rest, (), _LOSS, poses=False)
    costs = _costs(fitted, rest, _LOSS)
    return np.bincount(rest.cameras, costs, minlength=len(coefficients)).astype(np.float64)


def _is_possible(lens: Lens) -> bool:
    """Whether it still grows outwards at its image's corner, where boards are seldom seen."""
    square = (lens.width**2 + lens.height**2) / (2 * lens.focal) ** 2
    return 1.0 + 3.0 * lens.k1 * square + 5.0 * lens.k2 * square**2 > limits.BOARD_SLOPE


def _checked(
    facts: Sequence[CameraFacts], distances: Float64s, seen: Corners3D, board: Board, sigmas: Float64s
) -> list[str]:
    """Refuses what does not hold together; the warnings where it hardly does."""
    warnings = []
    for index, (camera, sigma) in enumerate(zip(facts, sigmas.tolist(), strict=True)):
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


def _adjusted(rig: BoardRig, seen: Corners3D, sigmas: Float64s) -> Adjusted:
    """The rig as of what does not move: each corner at each time is a point."""
    corners = np.column_stack([seen.frames, seen.places])
    _, first, point_of = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(point_of.reshape(-1), kind="stable")
    tracks = Tracks(point_of.reshape(-1)[order], seen.cameras[order], order, seen.pixels[order], len(first))
    return Adjusted(rig.model, tracks, rig.world(seen)[first], rig.distances(seen)[order], sigmas)


def adjust_rig(
    rig: BoardRig, seen: Corners3D, coefficients: tuple[int, ...], loss: float, *, poses: bool = True
) -> BoardRig:
    """The rig that explains the corners best, from a start near it; frames without a corner stay.

    Args:
        coefficients: for each camera how many of k1 and k2 are free beside its focal length; none: no lens is.
        loss: Cauchy's scale in pixels.
        poses: the cameras' are free.
    """
    reconstruction, config = _reconstruction(rig, seen, coefficients)
    options = adjustment_options(loss, _ITERATIONS)
    options.refine_points3D = False
    options.refine_sensor_from_rig = poses
    options.refine_focal_length = options.refine_extra_params = bool(coefficients)
    load_pycolmap().create_default_ceres_bundle_adjuster(options, config, reconstruction).solve()
    lenses, cameras, boards = list(rig.model.lenses), rig.model.poses.copy(), rig.boards.copy()
    for index, lens in enumerate(lenses):
        camera = reconstruction.camera(index + 1)
        freed = dict(zip(("k1", "k2"), camera.params[3:].tolist(), strict=False))
        lenses[index] = replace(lens, focal=float(camera.params[0]), **freed)
        if index:
            cameras[index] = reconstruction.rig(1).sensor_from_rig(camera.sensor_id).matrix()
    for frame in reconstruction.frames:
        boards[frame - 1, :3] = reconstruction.frame(frame).rig_from_world.matrix()
    return BoardRig(Model(cameras, tuple(lenses)), boards)


def _reconstruction(rig: BoardRig, seen: Corners3D, coefficients: tuple[int, ...]) -> tuple[Any, Any]:
    """pycolmap's, with its adjustment's configuration: an image for each camera and time that shows the board."""
    pycolmap = load_pycolmap()
    reconstruction, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
    colmap_rig = pycolmap.Rig(rig_id=1)
    for index, lens in enumerate(rig.model.lenses):
        camera = colmap_camera(lens, index + 1, coefficients[index] if coefficients else 2)
        reconstruction.add_camera(camera)
        if index:
            colmap_rig.add_sensor(camera.sensor_id, pycolmap.Rigid3d(rig.model.poses[index]))
        else:
            colmap_rig.add_ref_sensor(camera.sensor_id)
    reconstruction.add_rig(colmap_rig)
    places, corner_of = np.unique(seen.places, axis=0, return_inverse=True)
    tracks = [pycolmap.Track() for _ in places]
    for frame in np.unique(seen.frames).tolist():
        posed = pycolmap.Frame(frame_id=frame + 1, rig_id=1, rig_from_world=pycolmap.Rigid3d(rig.boards[frame, :3]))
        images = []
        for index in np.unique(seen.cameras[seen.frames == frame]).tolist():
            rows = np.flatnonzero((seen.frames == frame) & (seen.cameras == index))
            image_id = 1 + frame * len(rig.model.lenses) + index
            image = pycolmap.Image(
                f"{image_id:08d}", keypoints=seen.pixels[rows], camera_id=index + 1, image_id=image_id
            )
            image.frame_id = frame + 1
            posed.add_data_id(image.data_id)
            images.append(image)
            config.add_image(image_id)
            for row, corner in enumerate(corner_of.reshape(-1)[rows].tolist()):
                tracks[corner].add_element(image_id, row)
        reconstruction.add_frame(posed)
        for image in images:
            reconstruction.add_image(image)
    for place, track in zip(places, tracks, strict=True):
        reconstruction.add_point3D(place, track)
    return reconstruction, config
