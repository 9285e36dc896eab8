"""Films of textured cards that move before a textured wall, drawn by numpy and OpenCV: exact cameras, exact times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from support.builders import looking_at
from support.films import encode

from frog_blender.engine.capture.camera import Camera

from ..calibration.rigs import drawn

TURN = 2 * np.pi
_TEXTURE = 128  # texels of a card's side


def ring(count: int, width: int = 320, height: int = 240, spread: float = 28.0) -> dict[str, Camera]:
    """Cameras on an arc of `spread` degrees that look at the origin from 5 m; every second one stands higher."""
    cameras = {}
    for index in range(count):
        angle = np.radians(spread * (index / max(count - 1, 1) - 0.5))
        center = np.array([5 * np.sin(angle), -0.5 * (index % 2) - 0.3, -5 * np.cos(angle)])
        lens = np.array([[0.95 * width, 0, width / 2], [0, 0.95 * width, height / 2], [0, 0, 1]])
        name = f"cam{index:02d}"
        cameras[name] = looking_at(name, center, (width, height), lens, up=(0.0, -1.0, 0.0))
    return cameras


@dataclass(frozen=True)
class Card:
    """A textured square of `size` metres whose centre and turn are functions of the capture time in seconds."""

    texture: np.ndarray
    size: float
    center: Callable[[float], np.ndarray]
    turn: Callable[[float], float]

    def corners(self, time: float) -> np.ndarray:
        """(4, 3) metres: top left, top right, bottom right, bottom left."""
        angle = self.turn(time)
        right = np.array([np.cos(angle), np.sin(angle), 0.25 * np.sin(2 * angle)])
        down = np.array([-np.sin(angle), np.cos(angle), 0.0])
        half = self.size / 2
        places = [(-half, -half), (half, -half), (half, half), (-half, half)]
        return np.array([self.center(time) + u * right + v * down for u, v in places])


def texture(seed: int, side: int = _TEXTURE) -> np.ndarray:
    """(side, side, 3) uint8 blobs of several sizes."""
    random = np.random.default_rng(seed)
    total = np.zeros((side, side, 3), np.float32)
    for cells in (6, 12, 24):
        coarse = random.uniform(-1, 1, (cells, cells, 3)).astype(np.float32)
        total += cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    return (128 + 70 * total).clip(0, 255).astype(np.uint8)


def _path(seed: int, period: float | None) -> tuple[Callable[[float], np.ndarray], Callable[[float], float]]:
    """A smooth wandering; it repeats itself after `period` seconds where one is given."""
    random = np.random.default_rng(seed)
    if period is None:
        rates = random.uniform(0.13, 0.9, (3, 4))
    else:
        rates = random.integers(1, 4, (3, 4)) / period
    phases, sizes = random.uniform(0, TURN, (3, 4)), random.uniform(0.15, 0.35, (3, 4))
    sizes /= np.maximum(rates, 0.35) / 0.35
    start = random.uniform([-0.9, -0.6, -0.5], [0.9, 0.6, 0.5])
    swing = (random.integers(1, 3) / period if period else random.uniform(0.2, 0.5), random.uniform(0, TURN))

    def center(time: float) -> np.ndarray:
        return start + (sizes * np.sin(TURN * rates * time + phases)).sum(axis=1)

    def turn(time: float) -> float:
        return 0.5 * float(np.sin(TURN * swing[0] * time + swing[1]))

    return center, turn


def cards(count: int = 5, period: float | None = None) -> list[Card]:
    """Cards that wander about the origin."""
    return [Card(texture(10 + i), 1.0, *_path(100 + i, period)) for i in range(count)]


class MovingScene:
    """What every camera sees at a capture time."""

    def __init__(self, moving: list[Card]) -> None:
        self.moving = moving
        self._wall = Card(texture(1, 512), 9.0, lambda time: np.array([0.0, 0.0, 2.5]), lambda time: 0.0)
        self._backgrounds: dict[str, np.ndarray] = {}

    def image(self, camera: Camera, time: float) -> np.ndarray:
        """(H, W, 3) uint8 RGB."""
        if camera.name not in self._backgrounds:
            empty = np.zeros((camera.height, camera.width, 3), np.uint8)
            self._backgrounds[camera.name] = drawn(empty, camera, self._wall.texture, self._wall.corners(0.0))
        image = self._backgrounds[camera.name]
        nearest_last = sorted(self.moving, key=lambda card: -np.linalg.norm(card.center(time) - camera.center))
        for card in nearest_last:
            image = drawn(image, camera, card.texture, card.corners(time))
        return image


@dataclass(frozen=True)
class Start:
    """When a camera started, in seconds of capture time, its frames a second, and its clock's rate."""

    offset: float
    frames_per_second: int = 30
    rate: float = 1.0


def write_films(
    folder: Path, scene: MovingScene, cameras: dict[str, Camera], starts: dict[str, Start], seconds: float
) -> None:
    """A film of each camera; film time t shows capture time offset + rate * t."""
    for name, camera in cameras.items():
        start = starts[name]
        times = start.offset + start.rate * np.arange(0, seconds - 1e-9, 1 / start.frames_per_second)
        images = [scene.image(camera, time) for time in times.tolist()]
        encode(folder / f"{name}.mp4", images, rate=start.frames_per_second)
