"""Films of textured cards that move before a textured wall, drawn by numpy and OpenCV: exact cameras, exact times."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from support.builders import looking_at
from support.films import encode

from frog_blender.engine.capture.camera import Camera

from ..calibration.rigs import drawn

SIZE = (200, 150)
TURN = 2 * np.pi
_SQUARE = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
"""Top left, top right, bottom right, bottom left."""


def ring(count: int) -> dict[str, Camera]:
    """Cameras on an arc of 28 degrees that look at the origin from 5 m; every second one stands higher."""
    cameras, focal = {}, 0.95 * SIZE[0]
    lens = np.array([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]])
    for index, angle in enumerate(np.radians(np.linspace(-14, 14, count))):
        center = np.array([5 * np.sin(angle), -0.5 * (index % 2) - 0.3, -5 * np.cos(angle)])
        cameras[f"cam{index:02d}"] = looking_at(f"cam{index:02d}", center, SIZE, lens, up=(0.0, -1.0, 0.0))
    return cameras


def texture(seed: int, side: int) -> np.ndarray:
    """(side, side, 3) uint8 blobs of several sizes."""
    random = np.random.default_rng(seed)
    total = np.zeros((side, side, 3), np.float32)
    for cells in (6, 12, 24):
        coarse = random.uniform(-1, 1, (cells, cells, 3)).astype(np.float32)
        total += cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    return (128 + 70 * total).clip(0, 255).astype(np.uint8)


class Card:
    """A textured square of a metre that wanders about the origin without repeating itself."""

    def __init__(self, index: int) -> None:
        random = np.random.default_rng(100 + index)
        self.texture = texture(10 + index, 128)
        self._rates, self._phases = random.uniform(0.13, 0.9, (3, 4)), random.uniform(0, TURN, (3, 4))
        self._sizes = random.uniform(0.15, 0.35, (3, 4)) / np.maximum(self._rates / 0.35, 1)
        self._start = random.uniform([-0.9, -0.6, -0.5], [0.9, 0.6, 0.5])
        self._swing = random.uniform(0.2, 0.5), random.uniform(0, TURN)

    def center(self, time: float) -> np.ndarray:
        """(3,) metres, at a capture time in seconds."""
        return self._start + (self._sizes * np.sin(TURN * self._rates * time + self._phases)).sum(axis=1)

    def corners(self, time: float) -> np.ndarray:
        """(4, 3) metres."""
        angle = 0.5 * np.sin(TURN * self._swing[0] * time + self._swing[1])
        right = np.array([np.cos(angle), np.sin(angle), 0.25 * np.sin(2 * angle)])
        down = np.array([-np.sin(angle), np.cos(angle), 0.0])
        return self.center(time) + _SQUARE @ np.stack([right, down])


class MovingScene:
    """What every camera sees at a capture time."""

    def __init__(self) -> None:
        self._cards, self._wall = [Card(index) for index in range(5)], texture(1, 512)
        self._backgrounds: dict[str, np.ndarray] = {}

    def image(self, camera: Camera, time: float) -> np.ndarray:
        """(H, W, 3) uint8 RGB."""
        if camera.name not in self._backgrounds:
            empty = np.zeros((camera.height, camera.width, 3), np.uint8)
            corners = np.column_stack([9 * _SQUARE, np.full(4, 2.5)])
            self._backgrounds[camera.name] = drawn(empty, camera, self._wall, corners)
        image = self._backgrounds[camera.name]
        for card in sorted(self._cards, key=lambda card: -np.linalg.norm(card.center(time) - camera.center)):
            image = drawn(image, camera, card.texture, card.corners(time))
        return image


@dataclass(frozen=True)
class Start:
    """When a camera started, in seconds of capture time, its frames a second, and its clock's rate."""

    offset: float
    frames_per_second: int = 30
    rate: float = 1.0


def write_films(folder: Path, cameras: dict[str, Camera], starts: dict[str, Start], seconds: float) -> None:
    """A film of each camera; film time t shows capture time offset + rate * t."""
    scene = MovingScene()
    for name, camera in cameras.items():
        start = starts[name]
        times = start.offset + start.rate * np.arange(0, seconds - 1e-9, 1 / start.frames_per_second)
        images = [scene.image(camera, time) for time in times.tolist()]
        encode(folder / f"{name}.mp4", images, rate=start.frames_per_second)
