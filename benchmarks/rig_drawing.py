"""Draws rooms of textured rectangles exactly, for the rigs of calibration.py: rays, planes, mip maps, a mirror.

A second of 640 x 480 film takes about a second on one core, where Cycles would take minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

Array = np.ndarray
_FINER = 2  # rays a pixel, each way


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A flat thing: world corner and edges (metres), and its texture at all sizes.

    Attributes:
        texture: (H, W, 3) float32 of [0, 255], halved again and again; row 0 lies at the corner.
        shine: share of light that it mirrors.
    """

    corner: Array
    right: Array
    up: Array
    texture: tuple[Array, ...]
    shine: float = 0.0


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera: pose (3, 4) world to camera, the principal point in the middle, OpenCV's k1, gains of its colours."""

    name: str
    width: int
    height: int
    focal: float
    pose: Array
    k1: float = 0.0
    gains: Array = field(default_factory=lambda: np.ones(3))

    @property
    def center(self) -> Array:
        return -self.pose[:, :3].T @ self.pose[:, 3]

    def rays(self) -> Array:
        """(H, W, 3) float32 directions in the world through finer pixels, of depth 1."""
        x = (np.arange(self.width * _FINER) + 0.5) / _FINER - self.width / 2
        y = (np.arange(self.height * _FINER) + 0.5) / _FINER - self.height / 2
        seen = np.stack(np.meshgrid(x, y), axis=-1) / self.focal
        plane = seen
        for _ in range(30 if self.k1 else 0):
            plane = seen / (1 + self.k1 * (plane**2).sum(axis=-1, keepdims=True))
        local = np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1)
        return (local @ self.pose[:, :3]).astype(np.float32)

    def box(self, thing: Rectangle) -> tuple[slice, slice]:
        """Rows and columns of finer pixels outside of which it cannot be seen."""
        corners = np.array([thing.corner + a * thing.right + b * thing.up for a in (0, 1) for b in (0, 1)])
        local = corners @ self.pose[:, :3].T + self.pose[:, 3]
        if local[:, 2].min() < 0.2:
            return slice(None), slice(None)
        plane = local[:, :2] / local[:, 2:]
        square = (plane**2).sum(axis=1, keepdims=True)
        if self.k1 and square.max() > 0.5:
            return slice(None), slice(None)
        pixels = plane * (1 + self.k1 * square) * self.focal + [self.width / 2, self.height / 2]
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        margin = 4 + 0.1 * (high - low) * bool(self.k1)  # straight edges bend
        low, high = (np.stack([low - margin, high + margin]) * _FINER).clip(0, 1e5).astype(int)
        return slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)


def textured(image: Array, scale: float = 1.0) -> tuple[Array, ...]:
    """A texture of [0, 1] at all sizes, darkened by ``scale``."""
    levels = [np.asarray(image * (255 * scale), np.float32)]
    while min(levels[-1].shape[:2]) > 4:
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return tuple(levels)


@dataclass(frozen=True, eq=False)
class _Reflection:
    """What one mirror shows of what stands: rays from the mirrored eye, and colours and depths along them."""

    mirror: Rectangle
    box: tuple[slice, slice]
    origin: Array
    rays: Array
    surface: Array  # depth of the mirror itself
    colors: Array
    depths: Array


class Drawing:
    """What one camera sees: what stands is drawn once, what moves anew for each frame."""

    def __init__(self, eye: Eye, standing: Sequence[Rectangle]) -> None:
        self._eye, self._rays = eye, eye.rays()
        shape = self._rays.shape[:2]
        self._still = np.zeros((*shape, 3), np.float32), np.full(shape, np.inf, np.float32)
        self._standing = list(standing)
        for thing in self._standing:
            self._draw(thing, *self._still)
        self._mirrors = [self._reflect(thing) for thing in self._standing if thing.shine]

    def frame(self, moving: Sequence[Rectangle], noise: float, random: np.random.Generator) -> Array:
        """(H, W, 3) uint8 RGB, with noise of so many levels of 255."""
        colors, depths = (each.copy() for each in self._still)
        for thing in moving:
            self._draw(thing, colors, depths)
        for shown in self._mirrors:
            self._mirror(shown, moving, colors, depths)
        eye = self._eye
        image = cv2.resize(colors, (eye.width, eye.height), interpolation=cv2.INTER_AREA) * eye.gains.astype(np.float32)
        return (image + random.normal(0, noise, image.shape)).round().clip(0, 255).astype(np.uint8)

    def _draw(self, thing: Rectangle, colors: Array, depths: Array) -> None:
        box = self._eye.box(thing)
        if 0 in depths[box].shape:
            return
        _trace(thing, self._eye.center, self._rays[box], colors[box], depths[box], np.float32(0.05))

    def _reflect(self, mirror: Rectangle) -> _Reflection:
        """What a mirror shows of what stands."""
        box = self._eye.box(mirror)
        shape = self._still[1][box].shape
        depths = np.full(shape, np.inf, np.float32)
        normal = np.cross(mirror.right, mirror.up)
        normal /= np.linalg.norm(normal)
        origin = self._eye.center - 2 * ((self._eye.center - mirror.corner) @ normal) * normal
        plane = normal.astype(np.float32)
        rays = self._rays[box] - 2 * (self._rays[box] @ plane)[..., None] * plane
        shown = _Reflection(mirror, box, origin, rays, depths, np.zeros((*shape, 3), np.float32), depths.copy())
        if 0 in shape:
            return shown
        _trace(mirror, self._eye.center, self._rays[box], np.zeros((*shape, 3), np.float32), depths, np.float32(0.05))
        for thing in self._standing:
            if thing is not mirror:
                _trace(thing, origin, rays, shown.colors, shown.depths, depths + np.float32(0.01))
        return shown

    def _mirror(self, shown: _Reflection, moving: Sequence[Rectangle], colors: Array, depths: Array) -> None:
        """Adds what a mirror shows to the pixels that see it."""
        visible = np.isfinite(shown.surface) & (np.abs(shown.surface - depths[shown.box]) < 1e-3)
        if not visible.any():
            return
        seen, far = shown.colors.copy(), shown.depths.copy()
        for thing in moving:
            _trace(thing, shown.origin, shown.rays, seen, far, shown.surface + np.float32(0.01))
        part, shine = colors[shown.box], shown.mirror.shine
        part[visible] = (1 - shine) * part[visible] + shine * seen[visible]


def _trace(thing: Rectangle, origin: Array, rays: Array, colors: Array, depths: Array, least: Array) -> None:
    """Draws a rectangle where it is nearer than what is there and farther than ``least``."""
    normal = np.cross(thing.right, thing.up)
    facing = rays @ normal.astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32((thing.corner - origin) @ normal) / facing

        def along(edge: Array) -> Array:
            edge = edge / (edge @ edge)
            return np.float32((origin - thing.corner) @ edge) + depth * (rays @ edge.astype(np.float32))

        u, v = along(thing.right), along(thing.up)
        visible = (depth > least) & (depth < depths) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        if not visible.any():
            return
        rows, columns = (np.flatnonzero(visible.any(axis=axis)) for axis in (1, 0))
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        visible = visible[part]
        height, width = thing.texture[0].shape[:2]
        u, v = np.nan_to_num(u[part]) * width, np.nan_to_num(v[part]) * height
        level = _level(u, v).clip(0, len(thing.texture) - 1)
    drawn = np.zeros((*visible.shape, 3), np.float32)
    for number in range(int(level[visible].min()), int(np.ceil(level[visible].max())) + 1):
        share = np.maximum(1 - np.abs(level - number), 0)[..., None]
        image = thing.texture[number]
        scale = image.shape[1] / width, image.shape[0] / height
        drawn += share * cv2.remap(
            image, u * scale[0] - 0.5, v * scale[1] - 0.5, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    colors[part][visible] = drawn[visible]
    depths[part][visible] = depth[part][visible]


def _level(u: Array, v: Array) -> Array:
    """The level of the texture whose texels are as large as a ray's step."""
    steps = []
    for axis in (0, 1):
        if u.shape[axis] > 1:
            steps.append(np.hypot(np.gradient(u, axis=axis), np.gradient(v, axis=axis)))
    step = np.max(steps, axis=0) if steps else np.ones_like(u)
    return np.log2(np.maximum(step, 1e-6)).astype(np.float32)


Moving = Callable[[float], list[Rectangle]]
"""What moves, at a time in seconds."""
