"""Static cameras among posed images: images that are listed with the same pose and lens are one camera's.

Lists give every image a pose of its own, even those of videos from several static cameras (N3DV as 4D-GS's converter
writes it). Only in the images of a static camera is it known what changes.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Sequence

_FRAME_NUMBER = re.compile(r"[\W_]*\d*$")  # the end of what the names of a camera's images have in common


def first_images(views: Sequence[Hashable], times: Sequence[float]) -> list[int]:
    """For each image the index of its camera's first image.

    If every view was taken at several times, once at each, a view is one camera. Else every image is its own camera.

    Args:
        views: pose and lens of each image; equal where they are the same.
        times: of each image.
    """
    images: dict[Hashable, list[int]] = {}
    for index, view in enumerate(views):
        images.setdefault(view, []).append(index)
    if any(len(of) < 2 or len({times[index] for index in of}) < len(of) for of in images.values()):
        return list(range(len(views)))
    return [images[view][0] for view in views]


def camera_names(first: Sequence[int], names: Sequence[str]) -> list[str]:
    """The name of each image's camera: what the names of its images begin with (``cam00_0000``, ``cam00_0001``:
    cam00), or, where that tells no two cameras apart, its first image's.

    Args:
        first: see first_images.
        names: of each image, no two alike.
    """
    images: dict[int, list[str]] = {}
    for camera, name in zip(first, names, strict=True):
        images.setdefault(camera, []).append(name)
    common = {camera: _common(of) if len(of) > 1 else of[0] for camera, of in images.items()}
    if "" in common.values() or len({*common.values()}) < len(common):
        return [names[camera] for camera in first]
    return [common[camera] for camera in first]


def _common(names: Sequence[str]) -> str:
    first, last = min(names), max(names)  # what these two begin with, all do
    alike = next((index for index, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first))
    return _FRAME_NUMBER.sub("", first[:alike])
