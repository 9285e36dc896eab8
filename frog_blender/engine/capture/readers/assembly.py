"""From cameras and what they filmed to a capture: what the readers of most layouts have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ..camera import Camera
from ..capture import Capture, Distortion
from ..video import image_size, image_turns
from ..world import World
from .checks import check_images
from .footage import Calibrated, Filmed, Footage, at_times, fitted, on_common_frames

_FAR = 300.0  # times the cameras' spread: beyond it, float32's steps come near to what images show
_FAR_ALONE = 1000.0  # units, of cameras that all stand in one place
_TINY, _HUGE = 1e-3, 1e6  # spreads in units
HOLDOUT_EVERY = 8
"""Of one moving camera every eighth frame is held out."""


@dataclass(frozen=True, eq=False)
class View:
    """An image with a pose of its own.

    Attributes:
        camera: at its calibrated size.
        distortion: of its lens.
        image: the file.
        number: its time; see ``footage.at_times``.
    """

    camera: Camera
    distortion: Distortion | None
    image: Path
    number: int


def standing_cameras(
    path: Path,
    layout: str,
    cameras: Sequence[Calibrated],
    footage: Sequence[Footage],
    warnings: Sequence[str] = (),
    *,
    filmed: Filmed | None = None,
) -> Capture:
    """The capture of cameras that stand still, where camera i filmed ``footage[i]``. Nothing is held out.

    Args:
        filmed: the footage on common frames, where that is known.

    Raises:
        FrogError: if images do not have their camera's proportions, or cannot be used.
    """
    filmed = on_common_frames(path, footage) if filmed is None else filmed
    at_size = [
        fitted(calibrated, size, turns, each.files[0])
        for calibrated, size, turns, each in zip(cameras, filmed.sizes, filmed.turns, footage, strict=True)
    ]
    return Capture(
        path=path,
        format=layout,
        cameras=tuple(camera for camera, _ in at_size),
        distortions=tuple(lens for _, lens in at_size),
        shots=filmed.shots,
        frame_count=filmed.frame_count,
        frames_per_second=filmed.frames_per_second,
        warnings=(*warnings, *filmed.warnings, *_upside_down(path, [each.files[0] for each in footage], filmed.turns)),
    )


def moving_cameras(
    path: Path, layout: str, views: Sequence[View], rate: float = 30.0, warnings: Sequence[str] = ()
) -> Capture:
    """The capture of images that each have a pose of their own; of a single camera every eighth frame is held out.

    Raises:
        FrogError: if an image does not have its camera's proportions, or cannot be used.
    """
    check_images(path, len(views))
    shots, count = at_times(
        [(index, view.image) for index, view in enumerate(views)], [view.number for view in views], path
    )
    turns = [image_turns(view.image) for view in views]
    at_size = [
        fitted((view.camera, view.distortion), image_size(view.image), turn, view.image)
        for view, turn in zip(views, turns, strict=True)
    ]
    capture = Capture(
        path=path,
        format=layout,
        cameras=tuple(camera for camera, _ in at_size),
        distortions=tuple(lens for _, lens in at_size),
        shots=tuple(shots),
        frame_count=count,
        frames_per_second=rate,
        warnings=(*warnings, *_upside_down(path, [view.image for view in views], turns)),
    )
    alone = len({shot.frame for shot in shots}) == len(views) and capture.frame_count > HOLDOUT_EVERY // 2
    return _with_some_held_out(capture) if alone else capture


def _upside_down(path: Path, files: Sequence[Path], turns: Sequence[int]) -> list[str]:
    """A warning about files that are shown turned by 180 degrees: their size does not tell how they were calibrated."""
    turned = [file.name for file, turn in zip(files, turns, strict=True) if turn == 2]
    if not turned:
        return []
    return [
        f"{path}: {turned[0]} (of {len(turned)} such) is turned by 180 degrees, as the file says; the poses are taken "
        "for those of the turned images."
    ]


def with_points(capture: Capture, points: Float64s | None) -> Capture:
    """The capture with points (N, 3) on surfaces; without them for None and for none."""
    return capture if points is None or not len(points) else replace(capture, points=points)


def _with_some_held_out(capture: Capture) -> Capture:
    """The capture with every eighth frame held out, unless none of its images would be left to train on."""
    held = capture.with_holdout(HOLDOUT_EVERY)
    return held if held.train_shots else capture


def localized(capture: Capture) -> Capture:
    """The capture with an offset and a scale taken off where single precision would not do, and a sentence of it; most
    captures stay as they are."""
    centers = np.array([camera.center for camera in capture.cameras])
    middle = np.median(centers, axis=0)
    spread = float(np.linalg.norm(centers - middle, axis=1).max())
    near = capture.near_far[0] if capture.near_far is not None else 0.0
    extent = max(spread, near)
    unit = 1.0
    if 0 < extent < _TINY or extent > _HUGE:
        unit = 10.0 ** math.floor(math.log10(extent))
    origin = (0.0, 0.0, 0.0)
    if np.linalg.norm(middle) > (_FAR * extent if extent > 0 else _FAR_ALONE):
        step = 10.0 ** math.floor(math.log10(extent)) if extent > 0 else 1.0
        x, y, z = (np.round(middle / step) * step).tolist()
        origin = (x, y, z)
    world = World(origin, unit)
    if world.is_plain:
        return capture
    near_far = capture.near_far and (capture.near_far[0] / unit, capture.near_far[1] / unit)
    said = f"{capture.path}: the cameras' coordinates need more than single precision; they are taken as {world}."
    return replace(
        capture,
        cameras=tuple(world.local_camera(camera) for camera in capture.cameras),
        near_far=near_far,
        points=None if capture.points is None else world.local_points(capture.points),
        world=world,
        warnings=(*capture.warnings, said),
    )
