"""What moves in the room of make_room.py: surfaces as functions of time, in numpy alone.

Every function takes the phase of the loop (0 .. 1, after which the motion repeats) and returns vertices
(rows, columns, 3) in metres, z up; the cameras look along +y. None of it is rigid: an inflatable frog sways and swings
its arms, a banner carries travelling waves, a ball squashes where it bounces.
"""

from __future__ import annotations

import numpy as np
from shapes import TURN, frames, sphere, spine, tube

FROG_PLACE = np.array([-0.42, 0.15, 0.24])
BODY_LENGTH = 1.50
ARM_LENGTH = 0.70
BANNER_CORNER = np.array([0.92, 0.62, 2.22])  # upper left, on the rod
BANNER_SIZE = (1.06, 1.02)
BALL_PLACE = np.array([0.74, -0.55])
BALL_RADIUS = 0.21


def _body_spine(phase: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and directions (count, 3) of the frog's body: a bend that runs upwards, stronger towards the head."""
    s = np.linspace(0, 1, count)
    lean = 0.46 * s**0.7 * np.sin(TURN * (phase - 0.30 * s)) + 0.26 * s * np.sin(TURN * (2 * phase - 0.5 * s))
    nod = -0.10 + 0.30 * s * np.sin(TURN * (phase - 0.25 * s) + 1.3)
    directions = np.stack([np.sin(lean) * np.cos(nod), np.sin(nod), np.cos(lean) * np.cos(nod)], axis=1)
    return spine(FROG_PLACE, directions, BODY_LENGTH), directions


def frog_body(phase: float, rows: int = 72, columns: int = 48) -> np.ndarray:
    """The body with the head: a tube whose girth swells in rings that travel upwards, closed by a dome."""
    s = np.linspace(0, 1, rows)
    points, directions = _body_spine(phase, rows)
    girth = np.interp(s, [0, 0.08, 0.35, 0.62, 0.74, 0.84, 0.93, 1], [0.14, 0.18, 0.22, 0.18, 0.17, 0.22, 0.21, 0.16])
    girth = np.convolve(np.pad(girth, 4, mode="edge"), np.ones(9) / 9, mode="valid")
    dome = np.sqrt(np.clip((1 - s) / 0.11, 0, 1)) ** 0.9
    return tube(points, directions, girth * dome * (1 + 0.06 * np.sin(TURN * (2 * phase - 1.5 * s))), columns)


def frog_arm(phase: float, side: int, rows: int = 40, columns: int = 24) -> np.ndarray:
    """The right (side 1, towards +x) or left (-1) arm: swings up and down twice a loop, its end lags like a whip."""
    points, directions = _body_spine(phase, 100)
    lean = np.arctan2(directions[66, 0], directions[66, 2])
    s = np.linspace(0, 1, rows)
    swing = 0.35 + 0.75 * np.sin(TURN * (2 * phase + 0.25 * side - 0.30 * s)) + 0.5 * s - side * 0.6 * lean
    towards = -0.25 - 0.35 * s * np.cos(TURN * (phase - 0.2 * s))
    across = np.stack([side * np.cos(swing), towards, np.sin(swing)], axis=1)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    radii = np.interp(s, [0, 0.15, 0.70, 0.80, 0.92, 1], [0.09, 0.078, 0.065, 0.100, 0.105, 0.085])
    shoulder = points[66] + np.array([side * 0.12, -0.02, 0.0])
    return tube(spine(shoulder, across, ARM_LENGTH), across, radii * np.sqrt(np.clip((1 - s) / 0.06, 0, 1)), columns)


def frog_eye(phase: float, side: int, rows: int = 20, columns: int = 24) -> np.ndarray:
    """A ball on top of the head; its rows run from the back to the pupil, which looks at the cameras."""
    points, directions = _body_spine(phase, 100)
    back, across = frames(directions[92:93])
    center = points[92] + across[0] * side * 0.13 + directions[92] * 0.10 - back[0] * 0.07
    local = sphere(rows, columns)
    gaze = -back[0] + 0.12 * directions[92]
    return center + 0.105 * local @ np.stack([across[0], directions[92], gaze / np.linalg.norm(gaze)])


def banner(phase: float, rows: int = 56, columns: int = 48) -> np.ndarray:
    """A cloth on a rod (its top row stays), blown about by waves that run down it. Rows from the hem up."""
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    down = 1 - v
    width, height = BANNER_SIZE
    sideways = 0.15 * down**1.2 * np.sin(TURN * (2 * phase - 0.55 * down + 0.15 * u))
    sideways = sideways + 0.06 * down * np.sin(TURN * phase)
    outwards = 0.26 * down * (0.7 + np.sin(TURN * (2 * phase - 0.9 * down - 0.5 * u)))
    ripple = 0.05 * down**0.5 * np.sin(TURN * (3 * phase + 2.4 * u - 1.1 * down))
    lift = 0.16 * down**2 * (0.5 + 0.5 * np.sin(TURN * (2 * phase - 0.4 * u)))
    x = BANNER_CORNER[0] + width * u + sideways
    y = BANNER_CORNER[1] - outwards - ripple
    return np.stack([x, y, BANNER_CORNER[2] - height * down + lift], axis=-1)


def ball(phase: float, rows: int = 32, columns: int = 48) -> np.ndarray:
    """A ball that bounces twice a loop, drifts left and right, spins, squashes on the floor and stretches in flight."""
    beat = (2 * phase) % 1.0
    contact = 0.20  # share of a bounce spent on the floor
    if beat < contact:
        lift, stretch = 0.0, 1 - 0.38 * np.sin(np.pi * beat / contact)
    else:
        flight = (beat - contact) / (1 - contact)
        arc = 4 * flight * (1 - flight)
        lift, stretch = 0.52 * arc, 1 + 0.22 * abs(1 - 2 * flight) * min(1.0, 2 * arc)
    local = sphere(rows, columns)
    tilt, spin = 0.5, TURN * phase
    axis = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    turn = np.array([[np.cos(spin), -np.sin(spin), 0], [np.sin(spin), np.cos(spin), 0], [0, 0, 1]])
    shape = np.array([1 / np.sqrt(stretch), 1 / np.sqrt(stretch), stretch]) * BALL_RADIUS
    x = BALL_PLACE[0] + 0.15 * np.sin(TURN * phase)
    y = BALL_PLACE[1] + 0.10 * np.cos(TURN * phase)
    return np.array([x, y, BALL_RADIUS * stretch + lift + 0.015]) + (local @ (axis @ turn).T) * shape
