"""A room that the tests film themselves: textured walls, drawn exactly by the homography of each."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from support.builders import looking_at
from support.small_captures import write_film

from frog_blender.engine.capture.calibration.views import CameraFacts, View
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.synchronization.films import Film, Run
from frog_blender.engine.capture.video import VideoFacts
from frog_blender.engine.io.work_folder import WorkFolder, key_of

from .rigs import drawn

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
_TEXELS = 640


@lru_cache
def texture(seed: int) -> np.ndarray:
    """(640, 640) uint8 of overlapping discs: corners and blobs of all sizes."""
    random = np.random.default_rng(seed)
    image = np.full((_TEXELS, _TEXELS), 120, np.uint8)
    for _ in range(900):
        center = random.integers(0, _TEXELS, 2).tolist()
        size = random.integers(4, 26, 2).tolist()
        cv2.ellipse(image, center, size, float(random.uniform(0, 180)), 0, 360, int(random.integers(20, 240)), -1)
    return cv2.GaussianBlur(image, (0, 0), 1.2)


def walls(seed: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, int]]:
    """Corner, two edges and texture of each wall, the farthest first. World: x right, y down, z ahead."""
    return [
        (np.array([-3.0, -2.2, 3.0]), np.array([6.0, 0, 0.8]), np.array([0, 4.4, 0]), seed),
        (np.array([-2.4, 0.9, 0.6]), np.array([4.8, 0, 0]), np.array([0, 0.2, 2.6]), seed + 1),
        (np.array([-1.6, -1.0, 1.2]), np.array([1.1, 0, 0.5]), np.array([0, 1.9, 0.1]), seed + 2),
        (np.array([0.4, -0.6, 0.4]), np.array([1.2, 0, -0.4]), np.array([0.1, 1.4, 0]), seed + 3),
    ]


def camera(name: str, center: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 1.5)) -> Camera:
    """A level camera that looks at a target."""
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return looking_at(name, center, (WIDTH, HEIGHT), intrinsics, target, up=(0.0, -1.0, 0.0))


def rig() -> list[Camera]:
    """Five cameras on an arc, 10 degrees apart, at two heights."""
    places = [(-1.8, -0.3, -3.0), (-0.9, 0.2, -3.3), (0.0, -0.4, -3.4), (0.9, 0.1, -3.3), (1.8, -0.2, -3.0)]
    return [camera(f"cam{index}", eye) for index, eye in enumerate(places)]


def image(seen_by: Camera, seed: int = 1) -> np.ndarray:
    """(H, W) uint8: what a camera sees of the room."""
    result = np.full((seen_by.height, seen_by.width), 60, np.uint8)
    for corner, across, down, number in walls(seed):
        corners = corner + np.array([0 * across, across, across + down, down])
        result = drawn(result, seen_by, texture(number), corners)
    return result


def run_in(folder: Path, stages: set[str] | None = None) -> Run:
    """A run that keeps its stages in a folder, and tells which it goes through."""
    return Run(WorkFolder(folder), lambda stage, *_: None if stages is None else stages.add(stage), lambda: False)


def at_rest(plate: np.ndarray, changing: int = 0) -> View:
    """A view of nothing but its background."""
    return View(plate, np.full(plate.shape, changing, bool), np.empty((0, *plate.shape), np.uint8), np.empty(0, int))


def view(seen_by: Camera, seed: int = 1) -> View:
    """What calibration looks at, in which nothing moves."""
    return at_rest(image(seen_by, seed))


def film(path: Path, images: list[np.ndarray]) -> None:
    """Writes images (H, W) as a video of 10 frames a second, hardly compressed where it is an AVI."""
    write_film(path, [np.dstack([image] * 3) for image in images], 10.0)


def films(*names: str) -> list[Film]:
    """Three seconds each, of which there is no file."""
    facts = VideoFacts(WIDTH, HEIGHT, 30, 10.0, np.arange(30) / 10.0)
    return [Film(name, Path(f"{name}.mp4"), facts) for name in names]


def kept(run: Run, cameras: list[Camera], views: list[View]) -> list[CameraFacts]:
    """The views in the work folder."""
    files = []
    for seen_by, view in zip(cameras, views, strict=True):
        key = key_of(seen_by.name, *vars(view).values())
        run.work.keep("view", key, vars(view))
        files.append(CameraFacts(seen_by.name, seen_by.width, seen_by.height, key=key))
    return files
