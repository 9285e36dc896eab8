"""``frog export --html``: a scene and its player as one HTML file that needs no server and no network."""

from __future__ import annotations

import base64
import html
import json
import mimetypes
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from ...arrays import Array
from ...capture.camera import Camera
from ...errors import FrogError, found_instead
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ...playback.player import ScenePlayer
from .content import page_content

SCRIPTS = ("scene.js", "view.js", "splat_renderer.js", "page.js")
"""The player's own code, in the order in which it is put into the page."""
MOST_CAMERAS = 64
"""That a page offers to look through."""
_MOST_SOUND = 2**26  # bytes
_FIELD_OF_VIEW = 50.0  # degrees across, where a scene has no camera


def export_page(
    scene: ScenePlayer,
    frames: Sequence[int],
    path: Path,
    *,
    title: str = "",
    sound: Path | None = None,
    report: Callable[[int], None] | None = None,
) -> int:
    """Writes the page and returns its bytes; FrogError when it cannot, and then nothing is changed.

    Args:
        scene: to play.
        frames: counted from 0, evenly spaced and at least one.
        path: of the page.
        title: shown by the browser; the file's name by default.
        sound: an audio file that begins with the first frame.
        report: is told how many frames are done after each.
    """
    if not frames:
        raise FrogError(f"{path}: found no frames to export, expected at least one.")
    content = page_content(scene, frames, report)
    header = scene.header
    step = frames[1] - frames[0] if len(frames) > 1 else 1
    description: JsonObject = {
        **content.description,
        "frames_per_second": header.frames_per_second / step,
        "background": list(header.background),
        "cameras": [_camera(camera) for camera in _offered(scene)],
        "view": _first_view(scene),
    }
    written = _filled(title or path.stem, description, content.data, _sound(sound)).encode()
    write_atomically(path, written)
    return len(written)


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


def _sound(path: Path | None) -> str:
    """A data address, "" for none."""
    if path is None:
        return ""
    kind = mimetypes.guess_type(path.name)[0] or ""
    if not kind.startswith("audio/"):
        raise found_instead(path, "no audio file by its ending", "one such as .mp3, .m4a, .ogg or .wav")
    try:
        if path.stat().st_size > _MOST_SOUND:
            raise found_instead(path, f"{path.stat().st_size / 1e6:,.0f} MB", f"at most {_MOST_SOUND / 1e6:,.0f} MB")
        content = path.read_bytes()
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror or error})", "an audio file") from error
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _offered(scene: ScenePlayer) -> Sequence[Camera]:
    """At most MOST_CAMERAS of the scene's cameras, evenly spread."""
    cameras = scene.header.cameras
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


def _first_view(scene: ScenePlayer) -> JsonObject:
    """What the view turns about, which way is up, and where a scene without cameras is seen from."""
    cameras = scene.header.cameras
    means = scene.at_frame(0).means.astype(np.float64)
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
