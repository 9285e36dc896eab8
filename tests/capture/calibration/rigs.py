"""Rigs and what they see, made up: cameras about a room, and boards."""

from collections.abc import Sequence

import cv2
import numpy as np
from support.builders import looking_at

from frog_blender.engine.arrays import Array, Float64s, ImageArray
from frog_blender.engine.capture.calibration.board_detection import Board, Corners
from frog_blender.engine.capture.calibration.model import Calibration
from frog_blender.engine.capture.calibration.views import CameraFacts
from frog_blender.engine.capture.camera import Camera, rotation_about

WIDE = (1280, 720)


def looking(name: str, size: tuple[int, int], focal: float, eye: Sequence[float], at: Sequence[float]) -> Camera:
    """A camera at a place of a world with z up, upright, its principal point in the middle."""
    lens = np.array([[focal, 0.0, size[0] / 2], [0.0, focal, size[1] / 2], [0.0, 0.0, 1.0]])
    return looking_at(name, eye, size, lens, at)


def around(degrees: Sequence[float], size: tuple[int, int], focal: float, distance: float = 3.5) -> list[Camera]:
    """Cameras about the middle of a room, a metre and a half or so above the floor."""
    cameras = []
    for index, angle in enumerate(np.radians(degrees)):
        eye = [distance * np.cos(angle), distance * np.sin(angle), 1.4 + 0.3 * (index % 3)]
        cameras.append(looking(f"cam{index:02d}", size, focal, eye, [0.0, 0.0, 0.9]))
    return cameras


def facts_of(cameras: Sequence[Camera]) -> list[CameraFacts]:
    return [CameraFacts(camera.name, camera.width, camera.height) for camera in cameras]


def pixels_of(camera: Camera, points: Array, k1: float = 0.0, k2: float = 0.0) -> Float64s:
    """(N, 2) where points (N, 3) appear, distorted; NaN outside the image and behind it."""
    local = points @ camera.rotation.T + camera.world_to_camera[:3, 3]
    plane = local[:, :2] / local[:, 2:]
    squared = (plane**2).sum(1, keepdims=True)
    seen = plane * (1 + k1 * squared + k2 * squared**2) * camera.intrinsics[0, 0] + camera.intrinsics[:2, 2]
    inside = (local[:, 2] > 0) & (seen > 0).all(1) & (seen < (camera.width, camera.height)).all(1)
    return np.where(inside[:, None], seen, np.nan)


def drawn(image: ImageArray, camera: Camera, texture: ImageArray, corners: Array) -> ImageArray:
    """An image of a camera with a texture in it, whose corners lie at (4, 3): those at the top from left to right, then
    those at the bottom from right to left."""
    height, width = texture.shape[:2]
    flat = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32) - 0.5  # OpenCV counts from middles
    warp = cv2.getPerspectiveTransform(flat, (camera.project(corners)[0] - 0.5).astype(np.float32))
    size, over = (camera.width, camera.height), cv2.BORDER_TRANSPARENT
    return np.asarray(cv2.warpPerspective(texture, warp, size, dst=image.copy(), borderMode=over), np.uint8)


def board_poses(count: int, seed: int, tilt: float = 0.9) -> list[Float64s]:
    """(4, 4) poses of a board that is moved and turned about the middle of the room; ``tilt`` in radians."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        pose = np.eye(4)
        pose[:3, :3] = rotation_about(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)])) @ rotation_about(
            np.array([*rng.uniform(-tilt, tilt, 2), 0.0])
        )
        pose[:3, 3] = [*rng.uniform(-0.5, 0.5, 2), rng.uniform(0.4, 1.4)]
        poses.append(pose)
    return poses


def corners_seen(
    camera: Camera, board: Board, poses: Sequence[Float64s], noise: float, seed: int, *, k1: float = 0.0
) -> list[Corners | None]:
    """What a camera sees of the board's corners, ``noise`` pixels off; None where it shows fewer than six."""
    rng = np.random.default_rng(seed)
    seen: list[Corners | None] = []
    for pose in poses:
        pixels = pixels_of(camera, board.places @ pose[:3, :3].T + pose[:3, 3], k1)
        numbers = np.flatnonzero(np.isfinite(pixels[:, 0]))
        noisy = pixels[numbers] + rng.normal(0, noise, (len(numbers), 2))
        seen.append(Corners(numbers, noisy) if len(numbers) >= 6 else None)
    return seen


def rig_errors(found: Calibration | Sequence[Camera], truth: Sequence[Camera]) -> tuple[float, float, float, float]:
    """The worst centre in % of the rig's diameter, the worst rotation in degrees and focal length in %, all after the
    similarity that fits the centres best, and that similarity's scale."""
    cameras = [calibrated.camera for calibrated in found.cameras] if isinstance(found, Calibration) else found
    ours, theirs = (np.stack([camera.center for camera in rig]) for rig in (cameras, truth))
    from_middle, to_middle = ours - ours.mean(0), theirs - theirs.mean(0)
    turn, values = _nearest_turn(to_middle.T @ from_middle)
    scale = float(values.sum() / (from_middle**2).sum())
    diameter = np.linalg.norm(theirs[:, None] - theirs, axis=2).max()
    centers = np.linalg.norm(scale * from_middle @ turn.T - to_middle, axis=1) / diameter * 100
    pairs = list(zip(cameras, truth, strict=True))
    common, _ = _nearest_turn(sum(camera.rotation.T @ true.rotation for camera, true in pairs))
    cosines = [(np.trace(camera.rotation @ common @ true.rotation.T) - 1) / 2 for camera, true in pairs]
    focals = [abs(camera.intrinsics[0, 0] / true.intrinsics[0, 0] - 1) * 100 for camera, true in pairs]
    return float(centers.max()), float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()), max(focals), scale


def _nearest_turn(matrix: Float64s) -> tuple[Float64s, Float64s]:
    """The rotation nearest to a matrix (3, 3), and the matrix's singular values along it."""
    left, values, right = np.linalg.svd(matrix)
    signs = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    return left * signs @ right, values * signs
