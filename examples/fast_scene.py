"""An empty hall, for make_fast.py: fast things with texture before plain surroundings, and one that appears.

A shuttle flies across the view, a striped hammer swings on its rod, and halfway through the video a spring doll
appears.
"""

from __future__ import annotations

import bpy
import numpy as np
import shapes
import textures as paint
from scene_parts import Scene, box, lamp, material, plain, surroundings, wall
from shapes import TURN

HALF_WIDTH, BACK, FRONT, HEIGHT = 5.0, 2.2, -5.5, 4.5
FRAMES = 30
APPEARS = 15  # the first frame that shows the doll
SHUTTLE_STEP = 0.36  # metres a frame
PIVOT = np.array([1.25, 0.55, 2.95])
DOLL = np.array([-0.95, -0.15, 0.0])


def shuttle(phase: float, rows: int = 48, columns: int = 32) -> np.ndarray:
    """A long body that flies from left to right on a shallow arc and rolls a little, tail first in its rows."""
    frame = FRAMES * phase
    x = SHUTTLE_STEP * (frame - 12.5)
    center = np.array([x, -0.35, 1.30 + 0.22 * np.cos(0.5 * x)])
    direction = np.array([1.0, 0.0, -0.11 * np.sin(0.5 * x)])
    side = np.array([0.0, np.cos(0.08 * frame), np.sin(0.08 * frame)])
    s = np.linspace(0, 1, rows)
    radii = 0.19 * np.sqrt(np.clip(1 - np.abs(2 * s - 1) ** 2.6, 0, 1))
    angle = TURN * np.arange(columns) / columns
    up = np.cross(direction, side)
    around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up
    return center + ((s - 0.5) * 0.95)[:, None, None] * direction + radii[:, None, None] * around


def hammer_direction(phase: float) -> np.ndarray:
    """From the pivot to the hammer's head (3,): three swings in the video."""
    swing = 0.52 * np.sin(3 * TURN * phase)
    return np.array([np.sin(swing), 0.0, -np.cos(swing)])


def rod(phase: float) -> np.ndarray:
    return shapes.bar(PIVOT, PIVOT + 1.35 * hammer_direction(phase), 0.022)


def hammer(phase: float) -> np.ndarray:
    """The head: a thick bar at right angles to the rod."""
    down = hammer_direction(phase)
    across = np.array([-down[2], 0.0, down[0]]) * 0.36
    return shapes.bar(PIVOT + 1.40 * down - across, PIVOT + 1.40 * down + across, 0.17, 24)


def doll(phase: float, rows: int = 48, columns: int = 32) -> np.ndarray:
    """A cone of rings with a round top that stands on the floor and nods; it overshoots when it springs up."""
    since = max(0.0, FRAMES * phase - APPEARS)
    height = 1.05 * (1 - 0.45 * np.exp(-0.45 * since) * np.cos(1.1 * since))
    s = np.linspace(0, 1, rows)
    lean = 0.30 * s * np.sin(0.55 * since)
    directions = np.stack([np.sin(lean), np.zeros(rows), np.cos(lean)], axis=1)
    girth = np.interp(s, [0, 0.05, 0.6, 0.7, 0.85, 1], [0.25, 0.27, 0.15, 0.20, 0.22, 0.20])
    girth = np.convolve(np.pad(girth, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    radii = girth * np.sqrt(np.clip((1 - s) / 0.10, 0, 1))
    return shapes.tube(shapes.spine(DOLL, directions, height), directions, radii, columns)


def _hall() -> None:
    """Plain walls and floor of few tones, two blocks and a post: little for a seed to hold on to."""
    depth, width = BACK - FRONT, 2 * HALF_WIDTH
    wall("floor", (-HALF_WIDTH, FRONT, 0), (width, 0, 0), (0, depth, 0), _paint("floor", (0.50, 0.50, 0.48)))
    wall("back", (-HALF_WIDTH, BACK, 0), (width, 0, 0), (0, 0, HEIGHT), _paint("back", (0.66, 0.72, 0.76)))
    wall("left", (-HALF_WIDTH, FRONT, 0), (0, depth, 0), (0, 0, HEIGHT), _paint("left", (0.74, 0.70, 0.62)))
    wall("right", (HALF_WIDTH, BACK, 0), (0, -depth, 0), (0, 0, HEIGHT), _paint("right", (0.60, 0.70, 0.64)))
    wall("ceiling", (-HALF_WIDTH, BACK, HEIGHT), (width, 0, 0), (0, -depth, 0), _paint("ceiling", (0.8, 0.8, 0.78)))
    box("skirting", (0, BACK - 0.03, 0.12), (width, 0.06, 0.24), plain("skirting", (0.36, 0.38, 0.44)))
    box("block", (0.35, 0.95, 0.28), (0.56, 0.56, 0.56), plain("block", (0.80, 0.56, 0.30)), 0.4)
    box("second block", (-1.75, 0.85, 0.45), (0.5, 0.5, 0.9), plain("second block", (0.40, 0.50, 0.66)), -0.3)
    post = plain("post", (0.46, 0.34, 0.30))
    x, y, z = (float(value) for value in PIVOT)
    box("post", (x, y + 0.45, z / 2 + 0.1), (0.12, 0.12, z + 0.2), post)
    box("arm", (x, y + 0.2, z + 0.02), (0.10, 0.5, 0.10), post)


def _paint(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    """A plain colour with broad faint patches, as painted walls have."""
    patches = 0.03 * paint.noise(256, 256, 3, 12, 2)[..., None]
    return material(name, paint.finish(paint.flat(256, 256, color) + patches), 0.9)


class Hall(Scene):
    """The whole hall and what moves in it."""

    def build(self) -> None:
        _hall()
        for name, place, size, power, turn in [
            ("ceiling lamp", (-0.5, -1.0, HEIGHT - 0.1), 2.5, 190.0, (0.0, 0.0, 0.0)),
            ("front fill", (-1.9, -5.2, 3.0), 3.0, 330.0, (1.1, 0.0, -0.35)),
        ]:
            result = lamp(name, "AREA", power, (1.0, 0.97, 0.92), size)
            result.location, result.rotation_euler = place, turn
        surroundings((0.86, 0.92, 1.0), 0.5)
        body = material("shuttle", paint.checker((0.86, 0.20, 0.16), (0.97, 0.95, 0.88), 8, 10), 0.5)
        stripes = paint.stripes([(0.16, 0.22, 0.52), (0.97, 0.90, 0.60), (0.90, 0.44, 0.16)], 12, 3.0)
        rings = paint.stripes([(0.18, 0.50, 0.30), (0.96, 0.94, 0.80), (0.58, 0.20, 0.46)], 15)
        self.add_moving("shuttle", shuttle, body)
        self.add_moving("hammer", hammer, material("hammer", stripes, 0.5))
        self.add_moving("rod", rod, plain("rod", (0.25, 0.25, 0.28)))
        self.doll = self.add_moving("doll", doll, material("doll", rings, 0.5))

    def pose(self, phase: float) -> None:
        super().pose(phase)
        hidden = round(FRAMES * phase) < APPEARS
        self.doll.hide_render = self.doll.hide_viewport = hidden
