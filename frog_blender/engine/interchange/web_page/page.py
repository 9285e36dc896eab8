"""A take and its player as one HTML file that needs no server and no network."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Generator, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from ...arrays import Array
from ...capture.camera import Camera
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ..take import Take, duration_of, encoded
from .content import packed

SCRIPTS = ("scene.js", "view.js", "splat_renderer.js", "page.js")
"""The player's own code, in the order in which it is put into the page."""
MOST_CAMERAS = 64
"""That a page offers to look through."""
_FIELD_OF_VIEW = 50.0  # degrees across, where a scene has no camera


def write_page(path: Path, take: Take) -> Generator[int, None, None]:
    """Writes a take as a web page; yields how many frames are done. The file appears when all are.

    The capture is alone on its page, so that it does not matter where it was placed.

    Raises:
        FrogError: for another ending, more than a browser holds, sound that cannot be read, or a file that cannot be
            written.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise FrogError(f"{path}: found the ending {path.suffix!r}, expected .html.")
    content, data, means = yield from packed(take)
    cameras = _offered(take.header.cameras)
    numbers = take.numbers
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1.0
    description: JsonObject = {
        **content,
        "frames_per_second": take.rate / step,
        "background": list(take.header.background),
        "held": not take.keeps_identity,  # between frames: rows are other Gaussians in the next
        "cameras": [_camera(camera) for camera in cameras],
        "view": _first_view(cameras, means.astype(np.float64)),
    }
    sound = ""
    if take.sound is not None:
        ogg = encoded(take.sound, duration_of(take))
        sound = f"data:audio/ogg;base64,{base64.b64encode(ogg).decode()}"
    write_atomically(path, _filled(take.name, description, data, sound).encode())


def _filled(title: str, description: JsonObject, data: bytes, sound: str) -> str:
    folder = files(__package__)
    scripts = "\n".join((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)
    values = {
        "title": html.escape(title),
        "sound": sound,
        "scripts": scripts,
        # Neither may end the element that it stands in.
        "description": json.dumps(description, allow_nan=False).replace("<", "\\u003c"),
        "data": base64.b64encode(data).decode(),
    }
    page = (folder / "page.html").read_text(encoding="utf-8")
    pieces = page.split("{{")
    filled = [pieces[0]]
    for piece in pieces[1:]:
        name, _, rest = piece.partition("}}")
        filled += [values[name], rest]
    return "".join(filled)


def _offered(cameras: Sequence[Camera]) -> Sequence[Camera]:
    """At most MOST_CAMERAS of them, evenly spread."""
    if len(cameras) <= MOST_CAMERAS:
        return cameras
    return [cameras[int(place)] for place in np.linspace(0, len(cameras) - 1, MOST_CAMERAS)]


def _camera(camera: Camera) -> JsonObject:
    return {
        "name": camera.name,
        "size": [camera.width, camera.height],
        "intrinsics": [float(camera.intrinsics[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2))],
        "world_to_camera": [float(value) for value in camera.world_to_camera[:3].ravel()],
        "exposure": list(camera.exposure),
    }


def _first_view(cameras: Sequence[Camera], means: Array) -> JsonObject:
    """What the view turns about, which way is up, and where a scene without cameras is seen from."""
    middle = np.median(means, axis=0)
    reach = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.8)) or 1.0
    up = np.array([0.0, -1.0, 0.0])  # of most files without cameras
    if cameras:
        up = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
        up = up / norm if (norm := float(np.linalg.norm(up))) > 1e-6 else np.array([0.0, 0.0, 1.0])
        middle = _looked_at(cameras, middle)
    return {
        "target": [float(value) for value in middle],
        "up": [float(value) for value in up],
        "distance": 2.5 * reach,
        "field_of_view": _FIELD_OF_VIEW,
    }


def _looked_at(cameras: Sequence[Camera], middle: Array) -> Array:
    """The point nearest to all cameras' optical axes, or ``middle`` where it is behind most of them."""
    total, right = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.rotation[2], camera.rotation[2])
        total += across
        right += across @ camera.center
    if np.linalg.cond(total) > 1e4:  # parallel axes
        return middle
    point: Array = np.linalg.solve(total, right)
    ahead = [float(camera.rotation[2] @ (point - camera.center)) > 0 for camera in cameras]
    return point if sum(ahead) > len(ahead) / 2 else middle
