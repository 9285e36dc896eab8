"""The masks of a capture in words."""

from __future__ import annotations

from collections.abc import Callable

from .capture import Capture, Shot


def mask_lines(capture: Capture) -> list[str]:
    """What the masks of a capture are, a line for each kind; none where its images are whole."""
    found = [
        (_is_file, "only this: masks of"),
        (_is_alpha, "only this: alpha of"),
        (_is_ignored, "ignored: masks of"),
    ]
    lines = [f"{text} {counted}" for has, text in found if (counted := _counted(capture, has))]
    return [*lines, f"only this: what is not {capture.key}"] if capture.key else lines


def _is_file(shot: Shot) -> bool:
    return shot.mask is not None and not shot.mask.is_alpha


def _is_alpha(shot: Shot) -> bool:
    return shot.mask is not None and shot.mask.is_alpha


def _is_ignored(shot: Shot) -> bool:
    return shot.ignore is not None


def _counted(capture: Capture, has: Callable[[Shot], bool]) -> str:
    """``12 cameras, 30 frames each``; empty where no image has one."""
    shots = [shot for shot in capture.shots if has(shot)]
    if not shots:
        return ""
    cameras = len({shot.camera for shot in shots})
    if cameras == len(shots):
        return f"{len(shots)} images"
    each = len(shots) / cameras
    frames = f"{each:g} frames each" if each.is_integer() else f"{len(shots)} images in all"
    return f"{cameras} camera{'s' if cameras > 1 else ''}, {frames}"
