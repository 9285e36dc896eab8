"""The rigs of calibration.py, and how those of rendered_rigs.py are set up: places of cameras, lenses, the room."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Place = tuple[Sequence[float], Sequence[float]]  # where a camera stands, and at what it looks


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera: pose (3, 4) world to camera, the principal point in the middle, OpenCV's k1."""

    name: str
    width: int
    height: int
    focal: float
    pose: Array
    k1: float = 0.0

    @property
    def center(self) -> Array:
        return -self.pose[:, :3].T @ self.pose[:, 3]


@dataclass(frozen=True, eq=False)
class Case:
    """One rig in one room.

    Attributes:
        room: see ``calibration.POINTS``, or ``rendered_rigs.ROOMS``.
        shifts: seconds by which each film starts late; empty for films in step.
    """

    name: str
    room: str
    eyes: tuple[Eye, ...]
    shifts: tuple[float, ...] = ()

    @property
    def folder(self) -> str:
        """Its name, for a folder."""
        return re.sub(r"\W+", "-", self.name)


def eye(number: int, place: Place, focal: float = 1.0, size: tuple[int, int] = (640, 480), k1: float = 0.0) -> Eye:
    """A level camera; the focal length is over the longer side."""
    center, at = (np.array(each, float) for each in place)
    ahead = (at - center) / np.linalg.norm(at - center)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    pose = np.concatenate([rotation, -rotation @ center[:, None]], axis=1)
    return Eye(f"cam{number:02d}", *size, focal * max(size), pose, k1)


def ring(
    angles: Sequence[float], distance: float = 2.6, at: Sequence[float] = (0, 0, 0.9), spread: float = 0.3
) -> list[Place]:
    """Around the middle, at three heights; 0 degrees looks along +y."""
    places = []
    for number, angle in enumerate(np.radians(angles)):
        height = 1.3 + spread * (number % 3)
        places.append(((distance * np.sin(angle), -distance * np.cos(angle), height), at))
    return places


def arc(count: int, step: float, distance: float = 2.6) -> list[Place]:
    return ring([step * (number - (count - 1) / 2) for number in range(count)], distance)


def shaken(places: Sequence[Place], seed: int, amount: float = 0.25) -> list[Place]:
    """The places and targets a little off: nobody sets up a rig exactly."""
    random = np.random.default_rng(seed)
    return [
        (np.add(center, random.normal(0, amount * 0.4, 3)), np.add(at, random.normal(0, amount, 3)))
        for center, at in places
    ]


def eyes(
    places: Sequence[Place], focal: float = 1.0, size: tuple[int, int] = (640, 480), k1: float = 0.0
) -> tuple[Eye, ...]:
    return tuple(eye(number, place, focal, size, k1) for number, place in enumerate(places))


def stereo_pairs() -> list[Place]:
    """Four pairs, 12 cm apart each."""
    places = []
    for center, at in ring([-45, -15, 15, 45]):
        side = np.cross(np.subtract(at, center), [0, 0, 1.0])
        side *= 0.06 / np.linalg.norm(side)
        places += [(np.subtract(center, side), np.subtract(at, side)), (np.add(center, side), np.add(at, side))]
    return places


def row(count: int, spacing: float, toe: float, y: float = -2.5) -> list[Place]:
    """In one straight line; ``toe`` is how far each looks towards the middle, 0 for parallel."""
    xs = spacing * (np.arange(count) - (count - 1) / 2)
    return [((x, y, 1.4), ((1 - toe) * x, 1.0, 1.2)) for x in xs]


def facing_wall(count: int, toe: float) -> list[Place]:
    """A grid of cameras before one flat wall."""
    places = []
    for number in range(count):
        x, z = 0.7 * (number % 3 - 1), 1.2 + 0.6 * (number // 3)
        places.append(((x, -1.8 + 0.1 * (number % 2), z), ((1 - toe) * x, 2.0, 1.4 + (1 - toe) * (z - 1.4))))
    return places


def cases() -> list[Case]:
    """All of them, in the order of the table."""
    mixed = [0.7, 1.3, 0.9, 1.1, 0.8, 1.0]
    grid = shaken([*ring([-20, -7, 7, 20]), *[((x, y, 2.1), at) for (x, y, _), at in ring([-20, -7, 7, 20])]], 3)
    return [
        Case("ring of 8, 45 degrees apart", "attic", eyes(ring(range(0, 360, 45)), focal=0.8)),
        Case("ring of 12, 30 degrees apart", "attic", eyes(shaken(ring(range(0, 360, 30)), 1), focal=0.8)),
        Case("ring of 16, 22 degrees apart", "hall", eyes(shaken(ring(np.arange(16) * 22.5, 3.2), 2), focal=0.8)),
        Case("arc of 5, 10 degrees apart", "attic", eyes(shaken(arc(5, 10), 4))),
        Case("arc of 5, 20 degrees apart", "attic", eyes(shaken(arc(5, 20), 5))),
        Case("arc of 5, 30 degrees apart", "attic", eyes(shaken(arc(5, 30), 6))),
        Case("arc of 5, 40 degrees apart", "hall", eyes(shaken(arc(5, 40, 3.2), 7))),
        Case("arc of 6, 15 degrees apart", "hall", eyes(shaken(arc(6, 15, 3.2), 8))),
        Case("arc of 6, 15 degrees apart, little texture", "studio", eyes(shaken(arc(6, 15), 9))),
        Case("grid of 8", "studio", eyes(grid)),
        Case("4 stereo pairs", "attic", eyes(stereo_pairs())),
        Case("3 cameras, 12 degrees apart", "attic", eyes(shaken(arc(3, 12), 10))),
        Case("3 cameras, 25 degrees apart", "hall", eyes(shaken(arc(3, 25, 3.2), 11))),
        Case("3 cameras, little texture", "studio", eyes(shaken(arc(3, 15), 12))),
        Case("row of 6, parallel", "attic", eyes(row(6, 0.4, 0.0))),
        Case("row of 6, toed in", "hall", eyes(row(6, 0.5, 0.9))),
        Case("row of 5, parallel, little texture", "studio", eyes(row(5, 0.3, 0.0))),
        Case("6 before a flat wall, parallel", "wall", eyes(facing_wall(6, 0.0))),
        Case("6 before a flat wall, toed in", "wall", eyes(facing_wall(6, 0.9))),
        Case(
            "6 focal lengths of 0.7 to 1.3",
            "attic",
            tuple(eye(n, place, mixed[n]) for n, place in enumerate(shaken(arc(6, 12), 13))),
        ),
        Case(
            "2 kinds of cameras, 3 portrait",
            "hall",
            tuple(
                eye(n, place, 0.8 if n % 2 else 1.0, (480, 640) if n % 2 else (640, 480))
                for n, place in enumerate(shaken(arc(6, 12, 3.0), 14))
            ),
        ),
        Case("k1 = -0.2", "attic", eyes(shaken(arc(6, 12), 15), focal=0.7, k1=-0.2)),
        Case("k1 = -0.1, little texture", "studio", eyes(shaken(arc(6, 12), 16), focal=0.8, k1=-0.1)),
        Case("k1 = 0.08", "hall", eyes(shaken(arc(6, 12, 3.2), 17), focal=0.8, k1=0.08)),
        Case("k1 = -0.25, ring of 12", "hall", eyes(shaken(ring(range(0, 360, 30), 3.2), 18), focal=0.65, k1=-0.25)),
        Case("dark", "dark", eyes(shaken(arc(6, 10), 20))),
        Case("tele, focal length 2.5", "hall", eyes(shaken(arc(6, 8, 3.4), 25, 0.1), focal=2.5)),
        Case("wide, focal length 0.5", "attic", eyes(shaken(arc(6, 15), 26), focal=0.5)),
        Case("320 x 240", "attic", eyes(shaken(arc(7, 10), 27), size=(320, 240))),
        Case("portrait", "attic", eyes(shaken(arc(6, 12), 28), size=(480, 640))),
        Case("two groups of 3 back to back", "attic", eyes(shaken(ring([-12, 0, 12, 168, 180, 192]), 29))),
    ]
