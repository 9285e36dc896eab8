"""Pixel offsets as text: the pixel of a calibrated image at a cropped video's upper left corner."""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import FrogError


def parse_pixel_offsets(texts: Iterable[str], option: str = "Pixel Offset") -> dict[str, tuple[float, float]] | None:
    """Offsets (dx, dy) in pixels by camera from ``cam01=8,0`` and the like; None where there is none.

    Args:
        option: what the user calls them, for errors.

    Raises:
        FrogError: for a malformed text.
    """
    offsets = {}
    for text in texts:
        try:
            name, pair = text.split("=")
            dx, dy = pair.split(",")
            offsets[name] = (float(dx), float(dy))
        except ValueError:
            raise FrogError(f"{option} {text}: expected CAMERA=DX,DY such as cam01=8,0.") from None
    return offsets or None
