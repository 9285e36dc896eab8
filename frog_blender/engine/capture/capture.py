"""A recorded scene: its cameras, and which image is of which camera and frame.

A capture only refers to its images; ``engine.frames`` decodes them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from ..arrays import Float64s, ImageArray
from ..errors import FrogError, UsageError, found_instead
from .camera import Camera, cameras_move
from .masking import ChromaKey, MaskSource
from .time import frame_to_time
from .world import FILES_OWN, World

LARGEST_SIDE = 1600
"""Pixels of an image that is trained on where no scale is chosen."""
MAX_FRAMES = 1_000_000
"""Frames of a capture: nine hours at 30 a second."""
MAX_IMAGES = 4_000_000
"""Images of a capture: each takes a few hundred bytes of memory before it is decoded."""


@dataclass(frozen=True, eq=False)
class Distortion:
    """Lens distortion of the stored images; removed when frames are decoded.

    Attributes:
        coefficients: (4..14,) float64 in OpenCV's order k1 k2 p1 p2 k3 ..., or those of another ``model``.
        skew: K[0, 1] of the stored images over their focal length in x; removed too, so that cameras have none.
        model: ``"opencv"``, whose stored images have the camera's K, or one of ``lenses``.
        lens: (3, 3) K of the stored images over their width and height, where it is not the camera's: of all models
            but ``"opencv"``.
    """

    coefficients: Float64s
    skew: float = 0.0
    model: str = "opencv"
    lens: Float64s | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", np.asarray(self.coefficients, dtype=np.float64).reshape(-1))

    def cropped(self, left: float, top: float) -> Distortion:
        """That of images without what lies left of and above (left, top), shares of width and height."""
        if self.lens is None:
            return self
        return replace(self, lens=self.lens - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]]))


@dataclass(frozen=True)
class Shot:
    """One image: a camera at a frame.

    Attributes:
        camera: index into ``Capture.cameras``.
        frame: 0 .. ``Capture.frame_count`` - 1.
        path: the video or image file.
        index: frame within the video, 0 for an image.
        offset: frames by which the image was taken later than its frame, of -0.5 to 0.5.
        mask: of the subject, the only thing that is wanted of the image; None for the whole image.
        ignore: of what must not be learned or judged; None for nothing.
    """

    camera: int
    frame: int
    path: Path
    index: int
    offset: float = 0.0
    mask: MaskSource | None = None
    ignore: MaskSource | None = None


class Images(Protocol):
    """What seeding and hulls need of a frame store."""

    def image(self, shot_index: int) -> ImageArray:
        """(H, W, 3) uint8 sRGB."""

    def alpha(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8 the subject's share of each pixel, asked for where the capture has masks alone."""


class Alteration:
    """A deterministic change of decoded images, such as noise in robustness tests. Its repr says all that decides it.

    Attributes:
        tests_too: held-out images are changed as well.
    """

    tests_too = False

    def apply(self, image: ImageArray, camera: str, frame: int) -> ImageArray:
        """The changed image (H, W, 3) uint8 of the camera of this name at a frame."""
        raise NotImplementedError


def with_a_time(shots: Iterable[Shot], frame_count: int) -> list[Shot]:
    """The shots of which a capture of so many frames knows the time: they lie between its first and its last frame.

    Playback begins at the one and ends at the other, so an image of a part of a frame before or after would be learned
    at a time at which it was not taken. The only image of a camera stays.
    """
    if frame_count == 1:
        return list(shots)

    def is_inside(shot: Shot) -> bool:
        return 0 <= shot.frame + shot.offset <= frame_count - 1

    shots = list(shots)
    with_some = {shot.camera for shot in shots if is_inside(shot)}
    return [shot for shot in shots if is_inside(shot) or shot.camera not in with_some]


@dataclass(frozen=True, eq=False)
class Capture:
    """A recorded scene, opened but not decoded.

    Attributes:
        path: the capture's folder.
        format: a name of ``readers.detect``.
        cameras: undistorted pinhole cameras at the size of the stored frames.
        distortions: one for each camera, None where the lens needs no correction.
        shots: ordered by frame, then camera.
        frame_count: number of frames, at which each camera has at most one image.
        frames_per_second: of the videos; 30 where the format does not say.
        test_cameras: names of cameras that are held out.
        test_frames: frames that are held out in every camera.
        near_far: distances in world units between which the scene lies, where the format gives them.
        background: colour in [0, 1] under transparent images, and around subjects.
        points: (N, 3) float64 points on surfaces that came with the capture, world units; None for most.
        warnings: one sentence each.
        alteration: applied to the images after decoding; None for none.
        world: what the reader took off the files' coordinates.
        key: the colour of the backdrop, which is not part of the subject in any image; None for none.
    """

    path: Path
    format: str
    cameras: tuple[Camera, ...] = field(repr=False)
    distortions: tuple[Distortion | None, ...] = field(repr=False)
    shots: tuple[Shot, ...] = field(repr=False)
    frame_count: int
    frames_per_second: float = 30.0
    test_cameras: frozenset[str] = frozenset()
    test_frames: frozenset[int] = frozenset()
    near_far: tuple[float, float] | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points: Float64s | None = field(default=None, repr=False)
    warnings: tuple[str, ...] = ()
    alteration: Alteration | None = None
    world: World = FILES_OWN
    key: ChromaKey | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "shots", tuple(sorted(self.shots, key=lambda shot: (shot.frame, shot.camera))))

    @property
    def is_moving(self) -> bool:
        """True for one moving camera: every camera has one image, and no two training images share a frame.

        A held-out image may share it: of a rig of two cameras one is for training and the other is held out.
        """
        images = Counter(shot.camera for shot in self.shots)
        return cameras_move(images.values(), [shot.frame for shot in self.train_shots])

    @property
    def has_moving_cameras(self) -> bool:
        """True for one moving camera, or several that moved together: every camera that is trained on has one image.

        Held-out cameras do not count: D-NeRF's validation images of ``lego`` are all of one standing camera.
        """
        trained = self.train_shots
        images = Counter(shot.camera for shot in trained)
        return cameras_move(images.values(), [shot.frame for shot in trained], rig=True)

    @cached_property
    def has_masks(self) -> bool:
        """Whether some pixels may not be of the subject, or are to be ignored."""
        return self.key is not None or any(shot.mask or shot.ignore for shot in self.shots)

    def without_masks(self) -> Capture:
        """The capture whose images count as they are; itself where they do."""
        if not self.has_masks:
            return self
        return replace(self, key=None, shots=tuple(replace(shot, mask=None, ignore=None) for shot in self.shots))

    @cached_property
    def _shot_indices(self) -> dict[tuple[int, int], int]:
        return {(shot.camera, shot.frame): index for index, shot in enumerate(self.shots)}

    def shot_index(self, camera: int, frame: int) -> int | None:
        """Index into ``shots`` of a camera's image at a frame; None if there is none."""
        return self._shot_indices.get((camera, frame))

    def time_of(self, shot: Shot) -> float:
        """The time in [0, 1] at which a shot's image was taken."""
        return self.time_at(shot.frame + shot.offset)

    def time_at(self, frame: float) -> float:
        """The time in [0, 1] of a frame with its fraction; before the first and after the last one time stands.

        Readers leave out images of a camera before and after (``with_a_time``).
        """
        return frame_to_time(min(max(frame, 0.0), self.frame_count - 1.0), self.frame_count)

    def is_test(self, shot: Shot) -> bool:
        """True for a held-out image."""
        return shot.frame in self.test_frames or self.cameras[shot.camera].name in self.test_cameras

    @property
    def usual_scale(self) -> float:
        """The image size factor of a training where none is chosen: at most LARGEST_SIDE pixels a side."""
        return min(1.0, LARGEST_SIDE / max(max(camera.width, camera.height) for camera in self.cameras))

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """(H, W) of each image."""
        sizes = [(camera.height, camera.width) for camera in self.cameras]
        return [sizes[shot.camera] for shot in self.shots]

    @property
    def decoding_order(self) -> list[int]:
        """Indices in ``shots``, one file after the other, in ascending frames."""
        shots = self.shots
        return sorted(
            range(len(shots)), key=lambda index: (shots[index].camera, str(shots[index].path), shots[index].index)
        )

    @property
    def train_shots(self) -> tuple[Shot, ...]:
        """The training images."""
        return tuple(shot for shot in self.shots if not self.is_test(shot))

    @property
    def train_cameras(self) -> list[int]:
        """Indices of the cameras that have training images, ascending."""
        return sorted({shot.camera for shot in self.train_shots})

    @property
    def train_indices(self) -> list[int]:
        """Indices of the training images in ``shots``."""
        return [index for index, shot in enumerate(self.shots) if not self.is_test(shot)]

    def with_holdout(self, every: int) -> Capture:
        """The capture with frames ``f % every == every // 2`` held out in all cameras; 0 holds none out.

        Raises:
            FrogError: if nothing would be left to train on.
        """
        if every < 0 or every == 1:
            raise UsageError(f"Every {every} frames cannot be held out: give 0 for none, or 2 and more.")
        frames = frozenset(range(every // 2, self.frame_count, every)) if every else frozenset[int]()
        return replace(self, test_frames=frames)

    def scaled(self, scale: float) -> Capture:
        """The capture at another image size (rounded), itself for 1; the frame store resizes to it.

        Raises:
            FrogError: if the factor is not a positive finite number or leaves a camera without pixels.
        """
        if not (np.isfinite(scale) and scale > 0):
            raise FrogError(f"An image scale of {scale} makes no sense: give a positive number such as 0.5.")
        if scale == 1:
            return self
        cameras = []
        for camera in self.cameras:
            width, height = round(camera.width * scale), round(camera.height * scale)
            if min(width, height) < 8:
                raise FrogError(
                    f"An image scale of {scale} leaves {width} x {height} pixels of {camera.name}, expected 8 x 8."
                )
            cameras.append(camera.resized(width, height))
        return replace(self, cameras=tuple(cameras))

    def with_cameras(self, cameras: Iterable[Camera]) -> Capture:
        """The same images, said to be taken by these cameras: one for each of the capture's, in its order."""
        other = copy(self)  # keeps the cached indices: pose refinement calls this at every step
        object.__setattr__(other, "cameras", tuple(cameras))
        return other

    def with_pixel_offsets(self, offsets: Mapping[str, tuple[float, float]]) -> Capture:
        """The capture with videos known to begin at pixel (dx, dy) of their calibrated images.

        Call it on a capture at its own size (before ``scaled``).

        Raises:
            FrogError: for a name that is no camera, or an offset that is not two finite numbers.
        """
        names = [camera.name for camera in self.cameras]
        cameras, distortions = list(self.cameras), list(self.distortions)
        for name, offset in offsets.items():
            if name not in names:
                raise UsageError(f"{self.path}: found a pixel offset of {name!r}, expected one of {', '.join(names)}.")
            if len(offset) != 2 or not np.all(np.isfinite(offset)):
                raise FrogError(f"{self.path}: the pixel offset of {name} is {offset}, expected two finite numbers.")
            index, (dx, dy) = names.index(name), offset
            camera = cameras[index]
            cameras[index] = camera.cropped(dx, dy, camera.width, camera.height)
            if (lens := distortions[index]) is not None:
                distortions[index] = lens.cropped(dx / camera.width, dy / camera.height)
        return replace(self, cameras=tuple(cameras), distortions=tuple(distortions))

    def without_cameras(self, names: Collection[str]) -> Capture:
        """The capture without these cameras.

        Raises:
            FrogError: for a name that is no camera, or if no camera would be left.
        """
        known = {camera.name for camera in self.cameras}
        if not set(names) <= known:
            unknown = ", ".join(sorted(set(names) - known))
            raise FrogError(f"{self.path}: {unknown} cannot be left out, expected some of {', '.join(sorted(known))}.")
        if set(names) == known:
            raise FrogError(f"{self.path}: all {len(known)} cameras are left out, expected one to be left.")
        return self._with_shots(shot for shot in self.shots if self.cameras[shot.camera].name not in names)

    def segment(self, first: int, count: int) -> Capture:
        """The frames ``first`` .. ``first + count - 1`` as a capture of their own, whose frames count from 0.

        Raises:
            FrogError: if the capture does not have these frames.
        """
        if first < 0 or count < 1 or first + count > self.frame_count:
            asked = f"a request for frames {first} to {first + count - 1}"
            raise found_instead(self.path, asked, f"some of 0 to {self.frame_count - 1}")
        inside = (shot for shot in self.shots if first <= shot.frame < first + count)
        counted = [replace(shot, frame=shot.frame - first) for shot in inside]
        kept = self._with_shots(with_a_time(counted, count))
        frames = frozenset(frame - first for frame in self.test_frames if first <= frame < first + count)
        return replace(kept, frame_count=count, test_frames=frames)

    def _with_shots(self, shots: Iterable[Shot]) -> Capture:
        """The capture with these shots (their cameras as numbered here) and only the cameras that have one."""
        shots = tuple(shots)
        used = sorted({shot.camera for shot in shots})
        indices = {camera: index for index, camera in enumerate(used)}
        return replace(
            self,
            cameras=tuple(self.cameras[camera] for camera in used),
            distortions=tuple(self.distortions[camera] for camera in used),
            shots=tuple(replace(shot, camera=indices[shot.camera]) for shot in shots),
            test_cameras=self.test_cameras & {self.cameras[camera].name for camera in used},
        )


def mask_lines(capture: Capture) -> list[str]:
    """What the masks of a capture are, a line for each kind; none where its images are whole."""
    shots = capture.shots
    kinds = {
        "only this: masks of": [shot for shot in shots if shot.mask and not shot.mask.is_alpha],
        "only this: alpha of": [shot for shot in shots if shot.mask and shot.mask.is_alpha],
        "ignored: masks of": [shot for shot in shots if shot.ignore],
    }
    lines = [f"{text} {_counted(masked)}" for text, masked in kinds.items() if masked]
    return [*lines, f"only this: what is not {capture.key}"] if capture.key else lines


def _counted(shots: list[Shot]) -> str:
    """``12 cameras, 30 frames each``."""
    cameras = len({shot.camera for shot in shots})
    if cameras == len(shots):
        return f"{len(shots)} images"
    of_camera = len(shots) / cameras
    frames = f"{of_camera:g} frames each" if of_camera.is_integer() else f"{len(shots)} images in all"
    return f"{cameras} camera{'s' if cameras > 1 else ''}, {frames}"
