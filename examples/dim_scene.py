"""A cellar at night, for make_dim.py: one small lamp swings, so every shadow is hard and moves.

The lamp hangs in front of the view on a cord; a spoked wheel turns and a ball swings in its light.
"""

from __future__ import annotations

import bpy
import numpy as np
import shapes
import textures as paint
from scene_parts import Scene, box, lamp, material, surroundings, wall
from shapes import TURN

HALF_WIDTH, BACK, FRONT, HEIGHT = 2.4, 1.7, -5.0, 2.75
WHEEL = np.array([0.28, 0.35, 1.12])
WHEEL_RADIUS = 0.60
BALL_PIVOT = np.array([-0.78, -0.30, HEIGHT])
LAMP_POWER = 28.0  # watts of a lamp 2 cm wide


def lamp_place(phase: float) -> np.ndarray:
    """The swinging lamp's place (3,): one swing there and back, an ellipse seen from above."""
    swing = TURN * phase
    return np.array([0.1 + 1.10 * np.sin(swing), -2.1 + 0.25 * np.cos(swing), 2.05 + 0.22 * np.sin(swing) ** 2])


def spoke(phase: float, number: int) -> np.ndarray:
    """One of the wheel's three bars across; the wheel makes half a turn in the video."""
    angle = np.pi * phase + np.pi * number / 3
    reach = WHEEL_RADIUS * np.array([np.cos(angle), 0.0, np.sin(angle)])
    return shapes.bar(WHEEL - reach, WHEEL + reach, 0.035)


def hanging_ball(phase: float) -> np.ndarray:
    """A ball on a cord of 1.25 m that swings sideways once and turns."""
    swing = 0.42 * np.sin(TURN * phase + 0.9)
    down = np.array([np.sin(swing), 0.0, -np.cos(swing)])
    turn = 1.5 * np.sin(TURN * phase)
    across = np.array([np.cos(turn) * np.cos(swing), np.sin(turn), np.cos(turn) * np.sin(swing)])
    return shapes.ball(BALL_PIVOT + 1.25 * down, 0.21, np.stack([across, np.cross(-down, across), -down]))


def cord(phase: float) -> np.ndarray:
    swing = 0.42 * np.sin(TURN * phase + 0.9)
    return shapes.bar(BALL_PIVOT, BALL_PIVOT + 1.06 * np.array([np.sin(swing), 0.0, -np.cos(swing)]), 0.012)


def _cellar() -> None:
    """Brick walls, a floor of boards, a ceiling with beams."""
    depth, width = BACK - FRONT, 2 * HALF_WIDTH
    wall(
        "floor",
        (-HALF_WIDTH, FRONT, 0),
        (width, 0, 0),
        (0, depth, 0),
        material("boards", paint.planks(10, (0.55, 0.42, 0.30)), 0.7, (2, 2)),
    )
    bricks = material("bricks", paint.bricks(3), 0.9, (2, 1.2))
    stones = material("stones", paint.bricks(4, 9, 4), 0.9, (2, 1))
    wall("back", (-HALF_WIDTH, BACK, 0), (width, 0, 0), (0, 0, HEIGHT), bricks)
    wall("left", (-HALF_WIDTH, FRONT, 0), (0, depth, 0), (0, 0, HEIGHT), stones)
    wall("right", (HALF_WIDTH, BACK, 0), (0, -depth, 0), (0, 0, HEIGHT), stones)
    timber = material("timber", paint.planks(30, (0.46, 0.32, 0.21), 3), 0.9)
    wall("ceiling", (-HALF_WIDTH, BACK, HEIGHT), (width, 0, 0), (0, -depth, 0), timber)
    for number, y in enumerate(np.arange(-2.8, BACK, 1.1)):
        box(f"beam {number}", (0, float(y), HEIGHT - 0.08), (width, 0.16, 0.16), timber)


def _things() -> None:
    """A slatted screen, a pillar, crates and the wheel's stand: each throws a shadow of its own kind."""
    timber = material("slats", paint.planks(31, (0.66, 0.48, 0.30), 3), 0.8)
    for number in range(7):
        box(f"slat {number}", (-2.05 + 0.17 * number, 0.75, 0.80), (0.06, 0.05, 1.6), timber)
    for number, z in enumerate((0.25, 1.35)):
        box(f"rail {number}", (-1.54, 0.80, z), (1.2, 0.04, 0.10), timber)
    box("pillar", (1.62, 0.75, HEIGHT / 2), (0.30, 0.30, HEIGHT), material("pillar", paint.bricks(6, 14, 2), 0.9), 0.35)
    crates = [
        ((-1.28, -0.35, 0.23), 0.46, (0.80, 0.34, 0.26), (0.95, 0.86, 0.68), 0.4),
        ((-1.24, -0.32, 0.61), 0.30, (0.24, 0.42, 0.62), (0.93, 0.82, 0.40), -0.3),
        ((1.30, -0.30, 0.20), 0.40, (0.34, 0.54, 0.34), (0.92, 0.88, 0.74), -0.5),
        ((0.86, -0.75, 0.13), 0.26, (0.88, 0.58, 0.24), (0.32, 0.32, 0.42), 0.2),
    ]
    for number, (center, edge, first, second, turn) in enumerate(crates):
        box(
            f"crate {number}",
            center,
            (edge, edge, edge),
            material(f"crate {number}", paint.checker(first, second, 4, 4)),
            turn,
        )
    x, y, z = (float(value) for value in WHEEL)
    box("stand", (x, y + 0.16, z / 2), (0.12, 0.10, z), timber)
    box("foot", (x, y + 0.10, 0.06), (0.7, 0.4, 0.12), timber)
    box("axle", (x, y + 0.05, z), (0.07, 0.34, 0.07), timber)


class Cellar(Scene):
    """The whole cellar and what moves in it, the lamp included."""

    def build(self) -> None:
        _cellar()
        _things()
        self.lamp: bpy.types.Object = lamp("lamp", "POINT", LAMP_POWER, (1.0, 0.80, 0.55), 0.01)
        surroundings((0.5, 0.7, 1.0), 0.012)
        rim = material("rim", paint.stripes([(0.85, 0.30, 0.22), (0.96, 0.90, 0.74), (0.22, 0.42, 0.60)], 24), 0.7)
        spokes = material("spokes", paint.stripes([(0.92, 0.78, 0.34), (0.34, 0.24, 0.40)], 12), 0.7)
        rubber = material("ball", paint.checker((0.30, 0.62, 0.34), (0.97, 0.93, 0.82), 10, 6), 0.6)
        self.add_moving("rim", lambda phase: shapes.ring(WHEEL, WHEEL_RADIUS, 0.055, -np.pi * phase), rim)
        for number in range(3):
            self.add_moving(f"spoke {number}", lambda phase, number=number: spoke(phase, number), spokes)
        self.add_moving("ball", hanging_ball, rubber)
        self.add_moving("cord", cord, material("cord", paint.flat(8, 8, (0.6, 0.55, 0.45))))

    def pose(self, phase: float) -> None:
        super().pose(phase)
        self.lamp.location = lamp_place(phase)
