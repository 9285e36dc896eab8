"""Drawings of a calibration's report: SVG, and images with what was observed in them, to stand in one HTML page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import numpy as np

from ...arrays import Float64s, ImageArray
from ..video import load_opencv

_SIDE, _MARGIN = 560, 40
_DOTS = 1500  # points in the drawing of a rig
_FARTHEST = 8.0  # in halves of the rig's extent, from its middle: farther points do not widen a drawing
_WIDE = 480  # pixels of a camera's image
_GREEN, _RED = (60, 170, 40), (40, 40, 220)  # blue, green, red


def rig_from_above(names: Sequence[str], cameras: Float64s, directions: Float64s, points: Float64s) -> str:
    """The cameras and points as an SVG, y up.

    Args:
        cameras: (C, 2), x and y of each.
        directions: (C, 2), x and y of its viewing direction.
        points: (P, 3).
    """
    dots = points[:: max(1, len(points) // _DOTS), :2]
    middle, reach = frame_from_above(cameras, dots)
    near = dots[np.abs(dots - middle).max(axis=1, initial=0.0) <= reach]
    scale = (_SIDE / 2 - _MARGIN) / reach

    def at(place: Float64s) -> tuple[float, float]:
        x, y = (place - middle) * scale
        return round(float(x) + _SIDE / 2, 1), round(_SIDE / 2 - float(y), 1)

    parts = [f"<circle cx='{x}' cy='{y}' r='1' fill='#999'/>" for x, y in map(at, near)]
    for name, camera, direction in zip(names, cameras, directions, strict=True):
        (x, y), (ex, ey) = at(camera), at(camera + direction * 22 / scale)
        parts.append(f"<line x1='{x}' y1='{y}' x2='{ex}' y2='{ey}' stroke='#27c' stroke-width='2'/>")
        parts.append(f"<circle cx='{x}' cy='{y}' r='4' fill='#27c'/>")
        if name:
            parts.append(f"<text x='{x + 6}' y='{y - 6}' font-size='12'>{escape(name)}</text>")
    return f"<svg viewBox='0 0 {_SIDE} {_SIDE}' width='{_SIDE}' height='{_SIDE}'>{''.join(parts)}</svg>"


def frame_from_above(cameras: Float64s, points: Float64s) -> tuple[Float64s, float]:
    """The square that shows a rig and what it films: its middle, (2,), and half its side.

    Cameras beside each other span far less than the scene in front of them. A background far behind it is left out,
    or the cameras would be one dot.

    Args:
        cameras: (C, 2), x and y of at least one camera.
        points: (P, 2), may be empty.
    """
    low, high = cameras.min(axis=0), cameras.max(axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    near = points[np.abs(points - middle).max(axis=1, initial=0.0) <= _FARTHEST * reach]
    if len(near):
        low, high = np.minimum(low, np.quantile(near, 0.02, axis=0)), np.maximum(high, np.quantile(near, 0.98, axis=0))
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)


def camera_image(background: ImageArray, width: int, observations: Float64s) -> str:
    """A camera's background with observations in it, as an ``img`` element.

    Args:
        width: of the film, in whose pixels the observations are.
        observations: (N, 3) x, y, and 1 for those that agree.
    """
    cv2 = load_opencv()
    scale = _WIDE / width
    height = max(1, round(background.shape[0] * _WIDE / background.shape[1]))
    small = cv2.resize(background, (_WIDE, height), interpolation=cv2.INTER_AREA)
    image = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    for x, y, agrees in observations.tolist():
        cv2.circle(image, (int(x * scale), int(y * scale)), 2, _GREEN if agrees else _RED, -1, cv2.LINE_AA)
    return _element(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])


def wide_image(image: ImageArray) -> str:
    """An image (H, W, 3) RGB as an ``img`` element, without loss."""
    return _element(".png", image[..., ::-1])


def _element(ending: str, image: ImageArray, options: Sequence[int] = ()) -> str:
    _, content = load_opencv().imencode(ending, np.ascontiguousarray(image), options)
    kind = {".jpg": "jpeg", ".png": "png"}[ending]
    return f"<img alt='' src='data:image/{kind};base64,{base64.b64encode(content.tobytes()).decode()}'>"
