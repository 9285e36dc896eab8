"""Training images at a reduced size, and which of them see the same things."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TypeVar

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, Floats
from ..camera import Camera
from ..capture import Capture, Images
from ..video import shrunk

T = TypeVar("T")
SMALL = 320
"""Pixels of the longest side of images in which points are drawn."""
NUM_BACKGROUND_FRAMES = 9
_ENOUGH = 50  # points, to tell how deep a scene is


@dataclass(frozen=True, eq=False)
class Cloud:
    """N points.

    Attributes:
        points: (N, 3) float64 world units.
        colors: (N, 3) in [0, 1].
        frames: (N,) at which they are there; NaN of points that are there at all times.
        is_textured: (N,) True where the image had structure to measure depth with.
    """

    points: Float64s
    colors: Floats
    frames: Float64s
    is_textured: Bools

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, chosen: Array) -> Cloud:
        return Cloud(self.points[chosen], self.colors[chosen], self.frames[chosen], self.is_textured[chosen])


def cloud_of(points: Float64s, colors: Floats, frame: float = np.nan, is_textured: Bools | bool = False) -> Cloud:
    """Points that are all there at one frame, or at all times."""
    return Cloud(points, colors, np.full(len(points), frame), np.full(len(points), is_textured))


def joined(clouds: Iterable[Cloud]) -> Cloud:
    """All of their points; none of no clouds."""
    parts = [cloud_of(np.zeros((0, 3)), np.zeros((0, 3), np.float32)), *clouds]
    return Cloud(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Cloud)))


@dataclass(frozen=True, eq=False)
class View:
    """A training image and its camera, both reduced.

    Attributes:
        shot: index into ``Capture.shots``.
        camera: at the image's size.
        image: (H, W, 3) float32 in [0, 1].
    """

    shot: int
    camera: Camera
    image: Float32s


class TrainingImages:
    """A capture's training images, and nothing else of it.

    Attributes:
        capture: with its cameras.
        store: with its images.
        train: indices of the images into ``capture.shots``.
        by_frame: the same of each frame that has any.
    """

    def __init__(self, capture: Capture, store: Images) -> None:
        self.capture, self.store, self.train = capture, store, capture.train_indices
        self.by_frame: dict[int, list[int]] = {}
        for index in self.train:
            self.by_frame.setdefault(capture.shots[index].frame, []).append(index)

    @property
    def middle(self) -> list[int]:
        """The images of the middle frame."""
        frames = sorted(self.by_frame)
        return self.by_frame[frames[len(frames) // 2]]

    def views(self, shots: Sequence[int], longest_side: int = SMALL) -> list[View]:
        """Some of the images, reduced so that the longest side has at most ``longest_side`` pixels."""
        return [self._view(shot, longest_side) for shot in shots]

    def _view(self, shot: int, longest_side: int) -> View:
        if self.capture.is_test(self.capture.shots[shot]):
            raise AssertionError("a held-out image must not be read")
        image = shrunk(self.store.image(shot), longest_side)
        camera = self.capture.cameras[self.capture.shots[shot].camera].resized(image.shape[1], image.shape[0])
        return View(shot, camera, image.astype(np.float32) / np.float32(255))

    @cached_property
    def medians(self) -> dict[int, Float32s]:
        """For each static camera the median (H, W, 3) of its images over some frames: the static background."""
        stacks: dict[int, list[Float32s]] = {}
        for frame in spread(sorted(self.by_frame), NUM_BACKGROUND_FRAMES):
            for view in self.views(self.by_frame[frame]):
                stacks.setdefault(self.capture.shots[view.shot].camera, []).append(view.image)
        return {camera: np.median(np.stack(stack), axis=0) for camera, stack in stacks.items()}


def mean_colors(
    views: Sequence[View], points: Float64s, images: Sequence[Float32s] | None = None
) -> tuple[Float64s, Float64s]:
    """Mean colours (N, C) of points in the views that see them, and the variance (N,) over those, of all channels.

    Args:
        images: (H, W, C) of the views, where it is not their own.
    """
    seen_by = np.zeros((len(points), 1))
    color, square = np.zeros((len(points), 1)), np.zeros((len(points), 1))
    for view, image in zip(views, images or [view.image for view in views], strict=True):
        value, seen = view.camera.sample(points, image)
        shown = value.astype(np.float64).reshape(len(points), -1) * seen[:, None]
        seen_by, color, square = seen_by + seen[:, None], color + shown, square + shown**2
    total = np.maximum(seen_by, 1)
    color = color / total
    return color, np.maximum(square / total - color**2, 0).sum(axis=1)


def spread(items: Sequence[T], count: int) -> list[T]:
    """At most ``count`` of the items, evenly spread, the first and the last among them."""
    if len(items) <= count:
        return list(items)
    if count == 1:
        return [items[len(items) // 2]]
    return [items[round(i * (len(items) - 1) / (count - 1))] for i in range(count)]


def nearest_to_axes(cameras: Sequence[Camera]) -> Float64s | None:
    """(3,) the point nearest to all cameras' optical axes; None where these are parallel."""
    centers = np.array([camera.center for camera in cameras])
    forwards = np.array([camera.forward for camera in cameras])
    across = np.eye(3)[None] - forwards[:, :, None] * forwards[:, None, :]  # projections off each axis
    matrix = across.sum(axis=0)
    if not np.linalg.eigvalsh(matrix)[0] > 1e-3 * len(cameras):
        return None
    return np.linalg.solve(matrix, np.einsum("nij,nj->i", across, centers))


def scene_depth(cameras: Sequence[Camera]) -> float:
    """Distance from a typical camera to where the optical axes come closest to each other, world units."""
    centers = np.array([camera.center for camera in cameras])
    forwards = np.array([camera.forward for camera in cameras])
    # Where all stand in one place their mean may be off by a rounding, which is no extent.
    stands = not np.ptp(centers, axis=0).any()
    extent = 1.0 if stands else float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
    meeting = nearest_to_axes(cameras)
    if meeting is not None:
        depth = float(np.median(np.einsum("nj,nj->n", meeting - centers, forwards)))
        if np.isfinite(depth) and depth > 0.1 * extent:
            return depth
    return 5.0 * extent  # parallel axes: a scene some baselines away


def depth_range(cameras: Sequence[Camera], points: Float64s) -> tuple[float, float] | None:
    """Planar depths between which nearly all points (N, 3) lie before cameras, with a margin; None for few points."""
    depths = np.concatenate([camera.project(points)[1] for camera in cameras])
    ahead = depths[depths > 0]
    if min(len(points), len(ahead)) < _ENOUGH:
        return None
    low, high = np.percentile(ahead, [2, 98])
    return 0.7 * float(low), 1.6 * float(high)


def parallax(first: Camera, second: Camera, depth: float) -> float:
    """Angle in degrees between two cameras as seen from the point ``depth`` before the first; 180 if unseen."""
    target = first.center + depth * first.forward
    pixel, second_depth = second.project(target[None])
    margin = 0.5 * max(second.width, second.height)  # the images may overlap away from the first one's centre
    inside = -margin < pixel[0, 0] < second.width + margin and -margin < pixel[0, 1] < second.height + margin
    if second_depth[0] <= 0 or not inside:
        return 180.0
    rays = [camera.center - target for camera in (first, second)]
    cosine = rays[0] @ rays[1] / max(float(np.linalg.norm(rays[0]) * np.linalg.norm(rays[1])), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def neighbours(
    capture: Capture, reference: int, candidates: Sequence[int], depth: float, count: int, *, best_angle: float = 6.0
) -> list[int]:
    """Shots among the candidates that see what ``reference`` sees, from an angle good for measuring depth.

    Of a moving camera the frames close in time come first, because the scene moves meanwhile.
    """
    shot = capture.shots[reference]
    camera = capture.cameras[shot.camera]
    ranked = []
    for candidate in candidates:
        other = capture.shots[candidate]
        if other.camera == shot.camera:
            continue
        angle = parallax(camera, capture.cameras[other.camera], depth)
        if not 0.7 <= angle <= 35.0:
            continue
        ranked.append((abs(np.log(angle / best_angle)) + 0.15 * abs(other.frame - shot.frame), candidate))
    return [candidate for _, candidate in sorted(ranked)[:count]]
