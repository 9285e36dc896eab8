"""Builds the room of make_room.py in bpy: static furniture once, moving surfaces anew for every frame."""

from __future__ import annotations

import numpy as np
import room_motion as motion
import textures as paint
from scene_parts import Scene, box, lamp, material, plain, surroundings, wall

HALF_WIDTH = 2.6
BACK = 1.9
FRONT = -5.0
HEIGHT = 3.0


def _shell() -> None:
    """Floor, walls, ceiling with beams, rug and image."""
    depth, width = BACK - FRONT, 2 * HALF_WIDTH
    boards = material("boards", paint.planks(10, (0.62, 0.43, 0.27)), 0.55, (2, 2))
    wall("floor", (-HALF_WIDTH, FRONT, 0), (width, 0, 0), (0, depth, 0), boards)
    bricks = material("bricks", paint.bricks(), 0.9, (2.6, 1.5))
    wall("back", (-HALF_WIDTH, BACK, 0), (width, 0, 0), (0, 0, HEIGHT), bricks)
    left = material("left paper", paint.wallpaper((0.36, 0.56, 0.60), (0.44, 0.66, 0.68), 20), 0.9, (4, 1.75))
    wall("left", (-HALF_WIDTH, FRONT, 0), (0, depth, 0), (0, 0, HEIGHT), left)
    right = material("right paper", paint.wallpaper((0.86, 0.72, 0.50), (0.80, 0.58, 0.40), 21), 0.9, (4, 1.75))
    wall("right", (HALF_WIDTH, BACK, 0), (0, -depth, 0), (0, 0, HEIGHT), right)
    wall("ceiling", (-HALF_WIDTH, BACK, HEIGHT), (width, 0, 0), (0, -depth, 0), plain("plaster", (0.86, 0.84, 0.79)))
    timber = material("timber", paint.planks(30, (0.42, 0.27, 0.17), 2), 0.8)
    for index, y in enumerate(np.arange(FRONT + 0.6, BACK, 1.15)):
        box(f"beam {index}", (0, float(y), HEIGHT - 0.09), (width, 0.2, 0.18), timber)
    for side in (-1, 1):
        box(f"skirting {side}", (side * (HALF_WIDTH - 0.02), (FRONT + BACK) / 2, 0.08), (0.04, depth, 0.16), timber)
    box("skirting back", (0, BACK - 0.02, 0.08), (width, 0.04, 0.16), timber)
    box("rug", (0.1, -0.55, 0.008), (2.9, 2.1, 0.016), material("rug", paint.rug(), 0.95))
    box("frame", (0.12, BACK - 0.03, 1.86), (1.12, 0.06, 0.86), timber)
    wall("picture", (-0.38, BACK - 0.065, 1.49), (1.0, 0, 0), (0, 0, 0.74), material("landscape", paint.landscape()))


def _furniture() -> None:
    """A bookshelf, a table, blocks, the blower under the frog and the rod of the banner."""
    timber = material("shelf timber", paint.planks(31, (0.56, 0.38, 0.22), 3))
    spines = material("spines", paint.book_spines(), 0.7)
    x, y, width = -1.86, BACK - 0.2, 1.1
    for side in (-1, 1):
        box(f"shelf side {side}", (x + side * width / 2, y, 0.95), (0.05, 0.36, 1.9), timber)
    random = np.random.default_rng(5)
    for level in range(5):
        z = 0.06 + level * 0.455
        box(f"shelf {level}", (x, y, z), (width, 0.36, 0.04), timber)
        left, book = x - width / 2 + 0.04, level * 5
        while level < 4 and left < x + width / 2 - 0.14:
            thick, tall = random.uniform(0.055, 0.105), random.uniform(0.27, 0.39)
            column = (book % 16) / 16
            place = (left + thick / 2, y - 0.04 - random.uniform(0, 0.05), z + 0.02 + tall / 2)
            box(f"book {level} {book}", place, (thick * 0.95, 0.24, tall), spines, 0, (column, column + 1 / 16))
            left, book = left + thick, book + 1
    box("table", (1.72, 1.28, 0.62), (1.3, 0.7, 0.06), timber)
    for number, (dx, dy) in enumerate([(-0.58, -0.28), (0.58, -0.28), (-0.58, 0.28), (0.58, 0.28)]):
        box(f"leg {number}", (1.72 + dx, 1.28 + dy, 0.3), (0.07, 0.07, 0.6), timber)
    blocks = [
        ((-1.50, 0.15, 0.24), 0.48, (0.86, 0.32, 0.26), (0.96, 0.88, 0.72), 0.4),
        ((-1.53, 0.19, 0.63), 0.30, (0.20, 0.44, 0.66), (0.93, 0.80, 0.36), -0.25),
        ((-1.10, -0.75, 0.166), 0.30, (0.30, 0.56, 0.36), (0.92, 0.90, 0.80), 0.9),
        ((1.62, 0.05, 0.21), 0.42, (0.44, 0.28, 0.54), (0.94, 0.70, 0.46), -0.5),
        ((2.10, 0.45, 0.16), 0.32, (0.90, 0.62, 0.20), (0.28, 0.30, 0.40), 0.2),
    ]
    for number, (center, edge, first, second, turn) in enumerate(blocks):
        wear = material(f"block {number}", paint.checker(first, second, 4, 4))
        box(f"block {number}", center, (edge, edge, edge), wear, turn)
    blower = material("blower", paint.checker((0.16, 0.17, 0.20), (0.90, 0.74, 0.16), 8, 2), 0.6)
    foot = motion.FROG_PLACE
    box("blower", (float(foot[0]), float(foot[1]), 0.14), (0.46, 0.46, 0.28), blower, 0.3)
    rod = motion.BANNER_CORNER
    middle = float(rod[0]) + motion.BANNER_SIZE[0] / 2
    box("rod", (middle, float(rod[1]), float(rod[2]) + 0.02), (motion.BANNER_SIZE[0] + 0.3, 0.05, 0.05), timber)
    for side in (-1, 1):
        top = (HEIGHT + float(rod[2])) / 2
        box(f"cord {side}", (middle + side * 0.6, float(rod[1]), top), (0.02, 0.02, HEIGHT - float(rod[2])), timber)


def _lights() -> None:
    """Soft and constant: a wide lamp below the ceiling, a large fill from the open front, a little from everywhere."""
    for name, place, size, power, turn in [
        ("ceiling lamp", (-0.3, -0.5, HEIGHT - 0.22), 2.0, 72.0, (0.0, 0.0, 0.0)),
        ("front fill", (-1.9, -5.2, 2.5), 3.0, 250.0, (1.2, 0.0, -0.35)),
    ]:
        result = lamp(name, "AREA", power, (1.0, 0.96, 0.90), size)
        result.location, result.rotation_euler = place, turn
    surroundings((0.80, 0.88, 1.0), 1.2)


class Room(Scene):
    """The whole room and what moves in it."""

    def build(self) -> None:
        _shell()
        _furniture()
        _lights()
        skin = material("skin", paint.frog_skin(), 0.5)
        arm = material("arm", paint.frog_arm(), 0.5)
        eye = material("eye", paint.eye(), 0.3)
        cloth = material("banner", paint.banner(), 0.9)
        rubber = material("ball", paint.checker((0.90, 0.26, 0.20), (0.97, 0.93, 0.82), 12, 6), 0.4)
        self.add_moving("body", motion.frog_body, skin)
        self.add_moving("right arm", lambda phase: motion.frog_arm(phase, 1), arm)
        self.add_moving("left arm", lambda phase: motion.frog_arm(phase, -1), arm)
        self.add_moving("right eye", lambda phase: motion.frog_eye(phase, 1), eye)
        self.add_moving("left eye", lambda phase: motion.frog_eye(phase, -1), eye)
        self.add_moving("banner", motion.banner, cloth, closed=False)
        self.add_moving("ball", motion.ball, rubber)
