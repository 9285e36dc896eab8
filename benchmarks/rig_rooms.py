"""The rooms that calibration.py films: what stands in them, and somebody of boxes who walks about. Metres, z up."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

import textures as paint
from rig_drawing import Array, Moving, Rectangle, textured

Color = tuple[float, float, float]
_SUN = np.array([0.3, -0.5, 0.81])


@dataclass(frozen=True, eq=False)
class Room:
    """What stands and what moves; noise of the images in levels of 255."""

    standing: list[Rectangle]
    moving: Moving
    noise: float = 1.5


def blotches(seed: int, size: int = 512, count: int = 500, contrast: float = 1.0) -> Array:
    """Ellipses of all sizes and colours, as on a worn or painted thing."""
    random = np.random.default_rng(seed)
    image = np.full((size, size, 3), 0.5, np.float32)
    for _ in range(count):
        place = random.integers(0, size, 2).tolist()
        axes = np.maximum(2, size * random.uniform(0.004, 0.05, 2)).astype(int).tolist()
        color = (0.5 + contrast * random.uniform(-0.45, 0.45, 3)).tolist()
        cv2.ellipse(image, place, axes, float(random.uniform(0, 180)), 0, 360, color, -1, cv2.LINE_AA)
    return image


def tiles(count: int, color: Color, joint: float = 0.06) -> Array:
    """Square tiles that are all alike."""
    size = 1024
    u, v = paint.coordinates(size, size)
    edges = [np.abs(x * count - np.round(x * count)) < joint for x in (u, v)]
    inner = (np.hypot(u * count % 1 - 0.5, v * count % 1 - 0.5) < 0.2)[..., None] * 0.25
    return np.where((edges[0] | edges[1])[..., None], 0.85, np.array(color) - inner).clip(0, 1).astype(np.float32)


def tiled(image: Array, across: float, up: float) -> Array:
    """The image repeated so many times over a surface, of at most 2048 texels a side."""
    height, width = (min(2048, round(512 * each)) for each in (up, across))
    x = (np.arange(width) + 0.5) / width * across * image.shape[1] - 0.5
    y = (np.arange(height) + 0.5) / height * up * image.shape[0] - 0.5
    columns, rows = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    small = cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), 0.3 * max(1.0, across * image.shape[1] / width))
    return cv2.remap(small, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def wall(
    corner: Sequence[float], right: Sequence[float], up: Sequence[float], image: Array, shine: float = 0.0
) -> Rectangle:
    """A rectangle, lit by its direction."""
    a, b = np.array(right, float), np.array(up, float)
    normal = np.cross(a, b)
    light = 0.72 + 0.28 * abs(float(normal / np.linalg.norm(normal) @ _SUN))
    return Rectangle(np.array(corner, float), a, b, textured(image, light), shine)


def box(center: Sequence[float], size: Sequence[float], images: Sequence[Array], turn: float = 0.0) -> list[Rectangle]:
    """A box turned about z; its sides wear the images in turn."""
    half = np.array(size) / 2
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    sides = []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1, 1):
            corner = -half.copy()
            corner[axis] *= -sign
            right, up = np.zeros(3), np.zeros(3)
            right[one], up[other] = 2 * half[one], 2 * half[other]
            image = images[len(sides) % len(images)]
            sides.append(wall(center + spin @ corner, spin @ right, spin @ up, image))
    return sides


def person(seed: int, reach: float = 0.7, place: tuple[float, float] = (0.0, 0.0)) -> Moving:
    """Somebody of boxes who walks about and swings arms and legs."""
    coats = [blotches(seed + part, 256, 160) for part in range(6)]
    parts = [  # offset from the feet, size, swing
        ((0.0, 0.0, 1.15), (0.42, 0.24, 0.6), 0.0),
        ((0.0, 0.0, 1.62), (0.22, 0.22, 0.26), 0.0),
        ((0.30, 0.0, 1.15), (0.12, 0.14, 0.62), 0.5),
        ((-0.30, 0.0, 1.15), (0.12, 0.14, 0.62), -0.5),
        ((0.12, 0.0, 0.42), (0.16, 0.18, 0.82), -0.4),
        ((-0.12, 0.0, 0.42), (0.16, 0.18, 0.82), 0.4),
    ]

    worn: list[list[Rectangle]] = [
        box((0, 0, 0), size, [coat]) for (_, size, _), coat in zip(parts, coats, strict=True)
    ]

    def at(time: float) -> list[Rectangle]:
        turn = 1.3 * time
        spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        feet = np.array([place[0] + reach * np.cos(0.9 * time), place[1] + reach * np.sin(1.1 * time), 0.0])
        found = []
        for (offset, size, swing), sides in zip(parts, worn, strict=True):
            angle = swing * np.sin(5 * time)
            bend = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
            joint = np.array([0, 0, size[2] / 2])
            for side in sides:
                corner = bend @ (side.corner - joint) + joint + np.array(offset)
                found.append(
                    Rectangle(feet + spin @ corner, spin @ bend @ side.right, spin @ bend @ side.up, side.texture)
                )
        return found

    return at


def shell(
    floor: Array, walls: Sequence[Array], half: float = 3.0, height: float = 2.8, shine: float = 0.0
) -> list[Rectangle]:
    """A square room without a ceiling."""
    side = 2 * half
    return [
        wall((-half, -half, 0), (side, 0, 0), (0, side, 0), floor, shine),
        wall((-half, half, 0), (side, 0, 0), (0, 0, height), walls[0]),
        wall((half, half, 0), (0, -side, 0), (0, 0, height), walls[1 % len(walls)]),
        wall((half, -half, 0), (-side, 0, 0), (0, 0, height), walls[2 % len(walls)]),
        wall((-half, -half, 0), (0, side, 0), (0, 0, height), walls[3 % len(walls)]),
    ]


def attic(half: float = 3.0) -> Room:
    """Bricks, boards, paper, a rug, crates and pictures."""
    walls = [
        tiled(paint.bricks(), 2.6, 1.3),
        tiled(paint.wallpaper((0.36, 0.56, 0.60), (0.44, 0.66, 0.68), 20), 3, 1.5),
        tiled(paint.bricks(5, 12, 5), 2.2, 1.2),
        tiled(paint.wallpaper((0.86, 0.72, 0.50), (0.80, 0.58, 0.40), 21), 3, 1.5),
    ]
    things = shell(tiled(paint.planks(10, (0.62, 0.43, 0.27)), 2, 2), walls, half)
    things.append(wall((-1.3, -1.1, 0.01), (2.6, 0, 0), (0, 2.2, 0), paint.rug()))
    things += _pictures(half, 3)
    for number, (x, y, edge) in enumerate([(-1.7, 1.2, 0.7), (1.6, 1.5, 0.5), (1.8, -1.2, 0.6), (-1.6, -1.5, 0.45)]):
        things += box((x, y, edge / 2), (edge, edge, edge), [blotches(40 + number, 256, 200)], 0.4 * number)
    return Room(things, person(70))


def studio(half: float = 3.0) -> Room:
    """Plain painted walls, a grained floor, and a few objects: little texture, most of it in the middle."""
    plain = [0.62 + 0.03 * paint.noise(512, 512, 6, seed)[..., None] * np.ones(3) for seed in range(4)]
    things = shell(0.42 + 0.10 * paint.noise(1024, 1024, 32, 9)[..., None] * np.ones(3), plain, half)
    things += _pictures(half, 8)[:3]
    things += box((-0.9, 0.8, 0.4), (0.8, 0.5, 0.8), [blotches(50, 256, 90)], 0.3)
    things += box((1.0, 0.9, 0.55), (0.4, 0.4, 1.1), [paint.stripes([(0.8, 0.3, 0.2), (0.9, 0.9, 0.8)], 9, 1.0)], 0.7)
    return Room(things, person(71))


def hall(half: float = 4.0) -> Room:
    """Larger, painted walls with much detail, columns, stairs of boxes."""
    things = shell(
        tiled(blotches(90, 1024, 1500, 0.6), 2, 2),
        [blotches(91 + wall_, 1024, 1800, 0.8) for wall_ in range(4)],
        half,
        3.6,
    )
    for number, (x, y) in enumerate([(-2, 2), (2, 2), (-2.2, -1.8), (2.2, -2)]):
        things += box((x, y, 1.5), (0.4, 0.4, 3.0), [tiled(paint.bricks(60 + number, 8, 3), 1, 3)], 0.2 * number)
    for step in range(4):
        things += box(
            (0.2, 2.2 + 0.3 * step, 0.12 + 0.12 * step), (1.6, 0.3, 0.24 + 0.24 * step), [blotches(64 + step, 256, 220)]
        )
    return Room(things, person(72))


def bathroom(half: float = 3.0) -> Room:
    """Equal tiles everywhere, and a few things that are not alike."""
    things = shell(tiles(14, (0.55, 0.62, 0.66)), [tiles(16, (0.78, 0.80, 0.74))], half)
    things += box((-1.0, 1.0, 0.5), (0.9, 0.6, 1.0), [blotches(80, 256, 150)], 0.2)
    things += box((1.2, 0.6, 0.35), (0.6, 0.6, 0.7), [blotches(81, 256, 150)], 0.9)
    things += _pictures(half, 12)[:2]
    return Room(things, person(73))


def tiles_alone(half: float = 3.0) -> Room:
    """Equal tiles and nothing else that stands."""
    return Room(shell(tiles(14, (0.55, 0.62, 0.66)), [tiles(16, (0.78, 0.80, 0.74))], half), person(74))


def flat_wall(_half: float = 3.0) -> Room:
    """One painted wall that fills all images."""
    return Room([wall((-6, 2.0, -3), (12, 0, 0), (0, 0, 8), blotches(95, 2048, 6000))], person(75, 0.5))


def flat_wall_empty(_half: float = 3.0) -> Room:
    """The same, and nobody there."""
    return Room(flat_wall().standing, lambda _: [])


def mirrored(half: float = 3.0) -> Room:
    """The attic with a large mirror and a glossy floor."""
    room = attic(half)
    floor = room.standing[0]
    glossy = Rectangle(floor.corner, floor.right, floor.up, floor.texture, 0.35)
    glass = wall((-1.6, half - 0.05, 0.3), (3.2, 0, 0), (0, 0, 2.2), np.full((64, 64, 3), 0.9, np.float32), 0.9)
    return Room([glossy, *room.standing[1:5], *room.standing[6:], glass], room.moving)


def dark(half: float = 3.0) -> Room:
    """The studio at night: a tenth of the light, and noise."""
    room = studio(half)

    def dimmed(thing: Rectangle) -> Rectangle:
        return Rectangle(thing.corner, thing.right, thing.up, tuple(0.14 * each + 4 for each in thing.texture))

    return Room(
        [dimmed(each) for each in room.standing], lambda time: [dimmed(each) for each in room.moving(time)], 2.5
    )


def _pictures(half: float, seed: int) -> list[Rectangle]:
    """Two on each wall."""
    near = half - 0.03
    found = []
    for number, (x, z) in enumerate([(-1.4, 1.2), (0.5, 1.5)]):
        images = [blotches(seed * 100 + 10 * number + side, 512, 350) for side in range(4)]
        found += [
            wall((x, near, z), (0.9, 0, 0), (0, 0, 0.7), images[0]),
            wall((near, x, z), (0, 0.9, 0), (0, 0, 0.7), images[1]),
            wall((x, -near, z), (0.9, 0, 0), (0, 0, 0.7), images[2]),
            wall((-near, x, z), (0, 0.9, 0), (0, 0, 0.7), images[3]),
        ]
    return found


ROOMS: dict[str, Callable[[], Room]] = {
    "attic": attic,
    "studio": studio,
    "hall": hall,
    "bathroom": bathroom,
    "tiles": tiles_alone,
    "wall": flat_wall,
    "empty wall": flat_wall_empty,
    "mirrored": mirrored,
    "dark": dark,
}
"""By the name that a rig asks for."""
