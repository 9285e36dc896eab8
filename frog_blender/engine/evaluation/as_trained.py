"""A capture as a scene was trained on it: at its image size, with the camera poses that training refined."""

from __future__ import annotations

from collections.abc import Iterator

from ..capture.capture import Capture
from ..errors import FrogError
from ..scene.header import SceneHeader


def as_trained(header: SceneHeader, capture: Capture) -> Capture:
    """The capture at the image size that a scene was trained on, with the scene's own cameras.

    Args:
        capture: opened with ``header.pixel_offsets``, at its own size.

    Raises:
        FrogError: when it is another capture than the scene's.
    """
    sized = capture.scaled(header.scale)
    for found, expected in _facts(sized, header):
        if found != expected:
            raise FrogError(f"{capture.path}: found {found}, expected {expected} as the scene was trained on.")
    return sized.with_cameras(header.cameras)


def _facts(capture: Capture, header: SceneHeader) -> Iterator[tuple[str, str]]:
    """What both must have in common: of the capture, and of the scene."""
    yield (
        f"{len(capture.cameras)} cameras and {capture.frame_count} frames",
        f"{len(header.cameras)} cameras and {header.frame_count} frames",
    )
    for camera, own in zip(capture.cameras, header.cameras, strict=True):
        yield (
            f"camera {camera.name} of {camera.width} x {camera.height} pixels",
            f"camera {own.name} of {own.width} x {own.height} pixels",
        )
