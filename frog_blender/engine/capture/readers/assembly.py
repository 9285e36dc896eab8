"""From cameras and what they filmed to a capture: what the readers of most layouts have in common."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ..camera import Camera
from ..capture import Capture, Distortion
from ..natural_order import natural
from ..world import World
from .checks import check_images, check_names
from .filmed import of_cameras
from .footage import Footage
from .geometry import Calibrated, as_shown, is_transposed, same_proportions
from .pairing import Clock, Pairing, pair_footage, pair_images

_FAR = 300.0  # times the cameras' spread: beyond it, float32's steps come near to what images show
_FAR_ALONE = 1000.0  # units, of cameras that all stand in one place
_TINY, _HUGE = 1e-3, 1e6  # spreads in units
HOLDOUT_EVERY = 8
"""Of one moving camera every eighth frame is held out."""


PosedImage = tuple[Calibrated, Path, int]
"""An image with a pose of its own: its camera at its calibrated size, the file, and its time (``pair_images``)."""


def matched(
    calibration: Path, cameras: Sequence[Calibrated], footage: Sequence[Footage], *, named_by_film: bool = False
) -> tuple[list[Calibrated], list[Footage], list[str]]:
    """The cameras of a calibration that have footage, which is found by its name, in the order of their names; what
    each of them filmed; and warnings.

    Args:
        named_by_film: the cameras get the names of their footage.

    Raises:
        FrogError: if two cameras have one name, or none has footage.
    """
    names = [camera.name for camera, _ in cameras]
    check_names(names, calibration)
    filmed, warnings = of_cameras(calibration, names, footage)
    pairs = [((camera, lens), filmed[camera.name]) for camera, lens in cameras if camera.name in filmed]
    if named_by_film:
        pairs = [((replace(camera, name=film.name), lens), film) for (camera, lens), film in pairs]
    pairs.sort(key=lambda pair: natural(pair[0][0].name))
    return [camera for camera, _ in pairs], [film for _, film in pairs], warnings


def standing_cameras(
    path: Path,
    layout: str,
    cameras: Sequence[Calibrated],
    footage: Sequence[Footage],
    warnings: Sequence[str] = (),
    clocks: Sequence[Clock] = (),
) -> Capture:
    """The capture of cameras that stand still, where camera i filmed ``footage[i]``. Nothing is held out.

    Args:
        clocks: of the cameras' films (see ``pair_footage``).

    Raises:
        FrogError: if images do not have their camera's proportions, or cannot be used.
    """
    pairing = pair_footage(path, footage, clocks)
    return assembled(path, layout, cameras, footage, replace(pairing, warnings=[*warnings, *pairing.warnings]))


def moving_cameras(path: Path, layout: str, views: Sequence[PosedImage], warnings: Sequence[str] = ()) -> Capture:
    """The capture of images that each have a pose of their own; of a single camera every eighth frame is held out.

    Raises:
        FrogError: if an image does not have its camera's proportions, or cannot be used.
    """
    check_images(path, len(views))
    cameras, images, times = zip(*views, strict=True)
    pairing = pair_images(path, list(enumerate(images)), times)
    pairing = replace(pairing, warnings=[*warnings, *pairing.warnings])
    return with_holdout_of_one(assembled(path, layout, cameras, list(map(Footage.of_image, images)), pairing))


def assembled(
    path: Path, layout: str, cameras: Sequence[Calibrated], footage: Sequence[Footage], pairing: Pairing, **facts: Any
) -> Capture:
    """The capture of cameras at the size of what they filmed, ``footage[i]`` for camera i.

    Args:
        facts: what else a ``Capture`` has.

    Raises:
        FrogError: if an image does not have its camera's proportions.
    """
    at_size = [_fitted(*camera, of_camera) for camera, of_camera in zip(cameras, footage, strict=True)]
    warnings = list(pairing.warnings)
    if turned := [of_camera.files[0].name for of_camera in footage if of_camera.facts.turn == 180]:
        warnings.append(  # their size does not tell how they were calibrated
            f"{path}: {turned[0]} (of {len(turned)} such) is turned by 180 degrees, as the file says; the poses are "
            "taken for those of the turned images."
        )
    return Capture(
        path=path,
        format=layout,
        cameras=tuple(camera for camera, _ in at_size),
        distortions=tuple(lens for _, lens in at_size),
        shots=tuple(pairing.shots),
        frame_count=pairing.frame_count,
        frames_per_second=pairing.frames_per_second,
        warnings=tuple(warnings),
        **facts,
    )


def _fitted(camera: Camera, lens: Distortion | None, footage: Footage) -> Calibrated:
    """The calibrated camera, and its lens, at the size at which its images are shown; FrogError if their proportions
    differ."""
    camera, lens = as_shown(camera, lens, footage.facts)
    size = footage.facts.width, footage.facts.height
    if not same_proportions(size, (camera.width, camera.height)):
        turned = is_transposed(size, (camera.width, camera.height))
        hint = " (were they turned by 90 degrees after calibration?)" if turned else ""
        found = f"images of {size[0]} x {size[1]} pixels{hint}"
        expected = f"the proportions of the calibration, {camera.width} x {camera.height}"
        raise found_instead(footage.files[0], found, expected)
    return camera.resized(*size), lens


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
    extent = max(spread, capture.near_far[0] if capture.near_far is not None else 0.0)
    step = 10.0 ** math.floor(math.log10(extent)) if extent > 0 else 1.0
    is_far = np.linalg.norm(middle) > (_FAR * extent if extent > 0 else _FAR_ALONE)
    x, y, z = (np.round(middle / step) * step).tolist() if is_far else (0.0, 0.0, 0.0)
    world = World((x, y, z), step if 0 < extent < _TINY or extent > _HUGE else 1.0)
    if world.is_plain:
        return capture
    near_far = capture.near_far and (capture.near_far[0] / world.unit, capture.near_far[1] / world.unit)
    said = f"{capture.path}: the cameras' coordinates need more than single precision; they are taken as {world}."
    return replace(
        capture,
        cameras=tuple(world.local_camera(camera) for camera in capture.cameras),
        near_far=near_far,
        points=None if capture.points is None else world.local_points(capture.points),
        world=world,
        warnings=(*capture.warnings, said),
    )
