"""From cameras and what they filmed to a capture: what the readers of most layouts have in common."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ..capture import Capture, Shot
from ..video import image_size, image_turns
from ..world import World
from .checks import check_images
from .footage import Filmed, Footage, at_times, fitted, natural, of_cameras, on_common_frames
from .geometry import Calibrated

_FAR = 300.0  # times the cameras' spread: beyond it, float32's steps come near to what images show
_FAR_ALONE = 1000.0  # units, of cameras that all stand in one place
_TINY, _HUGE = 1e-3, 1e6  # spreads in units
HOLDOUT_EVERY = 8
"""Of one moving camera every eighth frame is held out."""


PosedImage = tuple[Calibrated, Path, int]
"""An image with a pose of its own: its camera at its calibrated size, the file, and its time (``footage.at_times``)."""


def calibrated_cameras(
    path: Path,
    layout: str,
    calibration: Path,
    cameras: Sequence[Calibrated],
    footage: Sequence[Footage],
    warnings: Iterable[str] = (),
    *,
    named_by_film: bool = False,
) -> Capture:
    """The capture of cameras of a calibration that stand still, and of their footage, which is found by its name.

    Args:
        named_by_film: the cameras get the names of their footage.

    Raises:
        FrogError: if two cameras have one name, none has footage, or images cannot be used.
    """
    names = [camera.name for camera, _ in cameras]
    if len(set(names)) < len(names):
        name, _ = Counter(names).most_common(1)[0]
        raise found_instead(calibration, f"several cameras named {name}", "one of each name")
    filmed, about = of_cameras(calibration, names, footage)
    pairs = [
        ((replace(camera, name=filmed[camera.name].name if named_by_film else camera.name), lens), filmed[camera.name])
        for camera, lens in cameras
        if camera.name in filmed
    ]
    pairs.sort(key=lambda pair: natural(pair[0][0].name))
    chosen, shown = [calibrated for calibrated, _ in pairs], [of_camera for _, of_camera in pairs]
    return standing_cameras(path, layout, chosen, shown, warnings=[*warnings, *about])


def standing_cameras(
    path: Path,
    layout: str,
    cameras: Sequence[Calibrated],
    footage: Sequence[Footage],
    *,
    warnings: Iterable[str] = (),
    filmed: Filmed | None = None,
) -> Capture:
    """The capture of cameras that stand still, where camera i filmed ``footage[i]``. Nothing is held out.

    Args:
        filmed: the footage on common frames, where that is known.

    Raises:
        FrogError: if images do not have their camera's proportions, or cannot be used.
    """
    filmed = on_common_frames(path, footage) if filmed is None else filmed
    return assembled(
        path,
        layout,
        cameras,
        [of_camera.files[0] for of_camera in footage],
        sizes=list(zip(filmed.sizes, filmed.turns, strict=True)),
        warnings=(*warnings, *filmed.warnings),
        shots=filmed.shots,
        frame_count=filmed.frame_count,
        frames_per_second=filmed.frames_per_second,
    )


def moving_cameras(
    path: Path, layout: str, views: Sequence[PosedImage], rate: float = 30.0, warnings: Iterable[str] = ()
) -> Capture:
    """The capture of images that each have a pose of their own; of a single camera every eighth frame is held out.

    Raises:
        FrogError: if an image does not have its camera's proportions, or cannot be used.
    """
    check_images(path, len(views))
    cameras, images, times = zip(*views, strict=True)
    shots, count = at_times(list(enumerate(images)), times, path)
    facts: dict[str, Any] = {"shots": tuple(shots), "frame_count": count, "frames_per_second": rate}
    return with_holdout_of_one(assembled(path, layout, cameras, images, warnings=warnings, **facts))


def assembled(
    path: Path,
    layout: str,
    cameras: Sequence[Calibrated],
    images: Sequence[Path],
    *,
    shots: tuple[Shot, ...],
    sizes: Sequence[tuple[tuple[int, int], int]] | None = None,
    warnings: Iterable[str] = (),
    **facts: Any,
) -> Capture:
    """The capture of cameras at the size of what they filmed.

    Args:
        images: a file of each camera.
        sizes: width and height of each, and the quarter turns by which it is shown; by default the files are asked.
        facts: what else a ``Capture`` has.

    Raises:
        FrogError: if an image does not have its camera's proportions.
    """
    sizes = [(image_size(image), image_turns(image)) for image in images] if sizes is None else sizes
    at_size = [fitted(*camera, *shown, image) for camera, shown, image in zip(cameras, sizes, images, strict=True)]
    said = list(warnings)
    if turned := [image.name for image, (_, turns) in zip(images, sizes, strict=True) if turns == 2]:
        said.append(  # their size does not tell how they were calibrated
            f"{path}: {turned[0]} (of {len(turned)} such) is turned by 180 degrees, as the file says; the poses are "
            "taken for those of the turned images."
        )
    return Capture(
        path=path,
        format=layout,
        cameras=tuple(camera for camera, _ in at_size),
        distortions=tuple(lens for _, lens in at_size),
        shots=shots,
        warnings=tuple(said),
        **facts,
    )


def with_holdout_of_one(capture: Capture) -> Capture:
    """The capture with every eighth frame held out, if it is of one moving camera and some image stays to train on."""
    frames = {shot.frame for shot in capture.shots}
    if len(frames) < len(capture.shots) or capture.frame_count <= HOLDOUT_EVERY // 2:
        return capture
    held = capture.with_holdout(HOLDOUT_EVERY)
    return held if held.train_shots else capture


def with_points(capture: Capture, points: Float64s | None) -> Capture:
    """The capture with points (N, 3) on surfaces; without them for None and for none."""
    return capture if points is None or not len(points) else replace(capture, points=points)


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
