"""Training images at a reduced size, and which of them see the same things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...arrays import Bools, Float32s, Float64s, Floats, ImageArray
from ..camera import Camera
from ..capture import Capture
from ..video import load_opencv

SMALL = 320
"""Pixels of the longest side of images in which points are drawn."""
NUM_BACKGROUND_FRAMES = 9
Value = TypeVar("Value", bound=np.generic)
Cloud = tuple[Float64s, Floats]
"""World points (N, 3) and their colours (N, 3) in [0, 1]."""


class Images(Protocol):
    """What seeding needs of a frame store."""

    def image(self, shot_index: int) -> ImageArray:
        """(H, W, 3) uint8 sRGB."""
        ...

    def alpha(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8 the subject's share of each pixel, asked for where the capture has masks alone."""
        ...


@dataclass(frozen=True, eq=False)
class View:
    """A training image and its camera, both reduced.

    Attributes:
        shot: index into ``Capture.shots``.
        frame: its frame.
        camera: at the image's size.
        image: (H, W, 3) float32 in [0, 1].
    """

    shot: int
    frame: int
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
        """Some of the images, reduced."""
        return [load_view(self.capture, self.store, shot, longest_side) for shot in shots]

    @cached_property
    def medians(self) -> dict[int, Float32s]:
        """For each static camera the median (H, W, 3) of its images over some frames: the static background."""
        stacks: dict[int, list[Float32s]] = {}
        for frame in spread(sorted(self.by_frame), NUM_BACKGROUND_FRAMES):
            for view in self.views(self.by_frame[frame]):
                stacks.setdefault(self.capture.shots[view.shot].camera, []).append(view.image)
        return {camera: np.median(np.stack(stack), axis=0) for camera, stack in stacks.items()}


def load_view(capture: Capture, store: Images, shot: int, longest_side: int) -> View:
    """The image of a training shot, reduced so that its longest side has at most ``longest_side`` pixels."""
    if capture.is_test(capture.shots[shot]):
        raise AssertionError("a held-out image must not be read")
    camera = capture.cameras[capture.shots[shot].camera]
    image = store.image(shot)
    factor = min(1.0, longest_side / max(camera.width, camera.height))
    if factor < 1:
        camera = camera.resized(round(camera.width * factor), round(camera.height * factor))
        cv2 = load_opencv()
        image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return View(shot, capture.shots[shot].frame, camera, image.astype(np.float32) / np.float32(255))


def sample_view(view: View, points: Float64s, image: NDArray[Value]) -> tuple[NDArray[Value], Bools]:
    """Values (N, ...) of an image where the points (N, 3) project, and whether (N,) the view sees them at all."""
    pixels, depths = view.camera.project(points)
    # The clip keeps the conversion to integers defined; positions far outside stay outside.
    columns, lines = np.floor(np.clip(pixels, -1.0, 1e6)).astype(int).T
    height, width = image.shape[:2]
    seen = (depths > 0) & (columns >= 0) & (lines >= 0) & (columns < width) & (lines < height)
    return image[np.where(seen, lines, 0), np.where(seen, columns, 0)], seen


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
        value, seen = sample_view(view, points, image)
        shown = value.astype(np.float64).reshape(len(points), -1) * seen[:, None]
        seen_by, color, square = seen_by + seen[:, None], color + shown, square + shown**2
    total = np.maximum(seen_by, 1)
    color = color / total
    return color, np.maximum(square / total - color**2, 0).sum(axis=1)


def spread(items: Sequence[int], count: int) -> list[int]:
    """At most ``count`` of the items, evenly spread, the first and the last among them."""
    if len(items) <= count:
        return list(items)
    if count == 1:
        return [items[len(items) // 2]]
    return [items[round(i * (len(items) - 1) / (count - 1))] for i in range(count)]


def scene_depth(cameras: Sequence[Camera]) -> float:
    """Distance from a typical camera to where the optical axes come closest to each other, world units."""
    centers = np.array([camera.center for camera in cameras])
    forwards = np.array([camera.forward for camera in cameras])
    across = np.eye(3)[None] - forwards[:, :, None] * forwards[:, None, :]  # projections off each axis
    matrix = across.sum(axis=0)
    # Where all stand in one place their mean may be off by a rounding, which is no extent.
    stands = not np.ptp(centers, axis=0).any()
    extent = 1.0 if stands else float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
    if np.linalg.eigvalsh(matrix)[0] > 1e-3 * len(cameras):
        meeting = np.linalg.solve(matrix, np.einsum("nij,nj->i", across, centers))
        depth = float(np.median(np.einsum("nj,nj->n", meeting - centers, forwards)))
        if np.isfinite(depth) and depth > 0.1 * extent:
            return depth
    return 5.0 * extent  # parallel axes: a scene some baselines away


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
