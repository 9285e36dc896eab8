"""Surfaces as grids of vertices (rows, columns, 3) in metres, z up; the cameras look along +y. Numpy alone."""

from __future__ import annotations

import numpy as np

TURN = 2 * np.pi


def spine(start: np.ndarray, directions: np.ndarray, length: float) -> np.ndarray:
    """(N, 3) points of a curve with the given unit directions (N, 3), beginning at `start`."""
    middle = (directions[1:] + directions[:-1]) / 2
    steps = middle / np.linalg.norm(middle, axis=1, keepdims=True) * (length / (len(directions) - 1))
    return start + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def frames(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) back (away from the cameras) and side axes at right angles to the directions (N, 3)."""
    tangent = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    back = np.array([0.0, 1.0, 0.0]) - tangent * tangent[:, 1:2]
    back /= np.linalg.norm(back, axis=1, keepdims=True)
    return back, np.cross(back, tangent)


def tube(points: np.ndarray, directions: np.ndarray, radii: np.ndarray, columns: int) -> np.ndarray:
    """(N, columns, 3) rings around a spine; the seam faces away from the cameras and the middle column towards them."""
    back, side = frames(directions)
    angle = TURN * np.arange(columns) / columns
    ring = np.cos(angle)[None, :, None] * back[:, None] - np.sin(angle)[None, :, None] * side[:, None]
    return points[:, None] + radii[:, None, None] * ring


def sphere(rows: int, columns: int) -> np.ndarray:
    """(rows, columns, 3) unit vectors from the pole -z to the pole +z."""
    polar = np.linspace(np.pi, 0, rows)[:, None]
    angle = TURN * np.arange(columns)[None] / columns
    x, y, z = np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def ball(center: np.ndarray, radius: float, axes: np.ndarray, rows: int = 24, columns: int = 32) -> np.ndarray:
    """A sphere about `center` (3,); the rows of `axes` (3, 3) are its own axes, the last one points to its pole."""
    return center + radius * sphere(rows, columns) @ axes


def bar(start: np.ndarray, end: np.ndarray, radius: float, columns: int = 16) -> np.ndarray:
    """A straight round bar between two points (3,), closed at both ends; its rows lie evenly along it."""
    s = np.concatenate([[0.0], np.linspace(0, 1, 24), [1.0]])
    direction = np.tile((end - start) / np.linalg.norm(end - start), (len(s), 1))
    radii = np.full(len(s), radius)
    radii[[0, -1]] = 0.0
    return tube(start + s[:, None] * (end - start), direction, radii, columns)


def ring(center: np.ndarray, radius: float, thickness: float, turn: float, rows: int = 72) -> np.ndarray:
    """A torus that faces the cameras, turned by `turn` radians about y; its first and last row are the same."""
    angle = np.linspace(0, TURN, rows)[:, None] + turn
    outwards = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    around = TURN * np.arange(16)[None, :, None] / 16
    section = np.cos(around) * outwards + np.sin(around) * np.array([0.0, 1.0, 0.0])
    return center + radius * outwards + thickness * section
