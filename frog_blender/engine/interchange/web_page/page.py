"""A take and its player as one HTML file that needs no server and no network, or as a folder for a server.

Frames are packed as small integers that a browser unpacks (``scene.js``). Positions keep 16 bits of an inverse
hyperbolic sine, fine in the middle of a scene and coarse far out; sizes (as logarithms), rotations, colours and
opacities have 8. What does not change in time is there once. What does is there for every frame as the difference from
the frame before, which ``zlib`` makes small: the smaller since numbers stay as they are where they would change by one
step, or where their Gaussian cannot be seen. All is one stream, in the order in which a page can show it: the first
frame without, then with its view-dependent colours, then frame by frame.
"""

import base64
import html
import json
import math
import re
import zlib
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from ... import rasterizer
from ...arrays import Array
from ...capture.camera import Camera
from ...capture.seeding.views import nearest_to_axes, spread
from ...capture.video import load_opencv
from ...errors import FrogError, UsageError
from ...gaussians import NumpyGaussians
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject, plain
from ...playback.frame_delta import column_names, column_of, normalize
from ...playback.render import render_image
from ...scene.quantization import by_significance
from ...scene.scene_file import WIDTHS
from ..take import Take, encoded

MOST_BYTES = 2**29
"""Of a scene's numbers once a browser has unpacked them."""
_SMALLEST_SCALE = 1e-12  # its logarithm is finite
_COLOR_STEPS, _SHAPE_STEPS, _POSITION_STEPS = 255, 127, 8191
_TAIL = 0.0005  # share of a frame's numbers at either end that may be cut off: few, and far from all others
_OPACITY = 3  # column of "base"
_HELD = 1  # steps by which a number may differ before it changes
_UNSEEN = 1  # the largest quantized opacity that is not seen
_ROW = 2048  # texels of a texture's row
_STEEPNESS = 8.0  # of a scene's spread: within it positions are about evenly fine


@dataclass(frozen=True)
class Quantizer:
    """Numbers as integers from 0 to ``steps``: ``low + value * (high - low) / steps`` undoes it, up to the curve.

    One byte holds 255 steps, two hold more.

    Attributes:
        curve: "linear", "exp" (the integers are logarithms) or "sinh".
        low, high: (width,) before the curve.
        center, spread: (width,) for "sinh": position = center + spread * sinh(value).
        steps: 255 or more.
    """

    curve: str
    steps: int
    low: Array
    high: Array
    center: Array | None = None
    spread: Array | None = None

    def quantize(self, column: Array) -> Array:
        """Unsigned integers in the shape of ``column`` (..., width)."""
        values = column.astype(np.float64)
        if self.curve == "exp":
            values = np.log(np.maximum(values, _SMALLEST_SCALE))
        elif self.center is not None and self.spread is not None:
            values = np.arcsinh((values - self.center) / self.spread)
        values = (values - self.low) / np.maximum(self.high - self.low, 1e-12)
        return np.asarray(np.rint(values.clip(0, 1) * self.steps), np.uint8 if self.steps < 256 else np.uint16)

    def to_json(self) -> JsonObject:
        """As ``scene.js`` reads it."""
        return dict(plain({name: value for name, value in vars(self).items() if value is not None}))


def packed(take: Take) -> Generator[int, None, tuple[JsonObject, bytes]]:
    """What a page holds of a take: a description in plain values, and of what it is one: all numbers, compressed.

    The frames are gone through twice: the steps in which numbers are stored are those of all of them. Yields 0 after
    each at first, then how many are done.
    """
    moved, columns, extents = take.num_dynamic, dict[str, Array](), dict[str, Array]()
    films: dict[str, list[Array]] = {name: [] for name in take.changing} if moved else {}
    for frame in take.frames():
        gaussians = frame.gaussians
        if not columns:
            names = column_names(gaussians.sh.shape[1])
            _refuse_too_large(take, len(gaussians), names)
            columns = {name: column_of(gaussians, name) for name in names}
            extents = {name: _extent(column) for name, column in columns.items()}
        for name in films:
            before, now = extents[name], _extent(column_of(gaussians, name, moved))
            extents[name] = np.concatenate([np.minimum(before[:2], now[:2]), np.maximum(before[2:], now[2:])])
        yield 0
    quantizers = {name: _quantizer(name, column, extents[name]) for name, column in columns.items()}
    for done, frame in enumerate(take.frames(), 1):
        for name, film in films.items():
            film.append(quantizers[name].quantize(_canonical(name, column_of(frame.gaussians, name, moved))))
        yield done
    steady = {name: _steady(name, np.stack(film)) for name, film in films.items()}
    seen = steady["base"][..., _OPACITY] > _UNSEEN if "base" in steady else None
    arrays: list[tuple[JsonObject, Array]] = []  # (T, M, width) integers
    for name, column in columns.items():
        still = column
        if name in steady:
            arrays.append(_described(name, quantizers[name], _held(name, steady[name], seen), film=True))
            still = column[moved:]
        if len(still):
            values = quantizers[name].quantize(_canonical(name, still))
            arrays.append(_described(name, quantizers[name], values[None], film=False))
    texels = len(columns)  # place and opacity, rotation, size; then one for each SH coefficient
    data = _compressed([values for _, values in arrays])
    description: JsonObject = {
        "count": len(columns["means"]),
        "dynamic": moved,
        "sh_count": len(columns) - 3,
        "texels": texels,
        "texture": [_ROW, -(-len(columns["means"]) * texels // _ROW)],
        "low_pass": take.header.low_pass,
        "frames": len(take.numbers),
        "bytes": len(data),
        "arrays": [described for described, _ in arrays],
    }
    return description, data


def _extent(column: Array) -> Array:
    """(4, width) how far numbers (N, width) reach: the least, the least and the most of all but a few, the most."""
    low, high = np.quantile(column.astype(np.float64), (_TAIL, 1 - _TAIL), axis=0)
    return np.stack([column.min(0).astype(np.float64), low, high, column.max(0).astype(np.float64)])


def _refuse_too_large(take: Take, count: int, names: Sequence[str]) -> None:
    frames = len(take.numbers)
    needed = 4 * count * sum(WIDTHS[name] for name in names)
    needed += 2 * frames * take.num_dynamic * sum(WIDTHS[name] for name in take.changing)
    if needed > MOST_BYTES:
        raise FrogError(
            f"A page of {frames} frames would unpack to {needed / 1e6:,.0f} MB in the browser, expected at most "
            f"{MOST_BYTES / 1e6:,.0f} MB; export fewer frames."
        )


def _quantizer(name: str, column: Array, extent: Array) -> Quantizer:
    """For a column (N, width) of the first frame, and how far it reaches in all."""
    width, (least, low, high, most) = column.shape[1], extent
    if name == "quaternions":
        return Quantizer("linear", _SHAPE_STEPS, np.full(4, -1.0), np.full(4, 1.0))
    if name == "scales":
        least, most = (np.log(np.maximum(bound, _SMALLEST_SCALE)) for bound in (low.min(), most.max()))
        return Quantizer("exp", _SHAPE_STEPS, np.full(width, least), np.full(width, most))
    if name == "means":
        center = np.median(column.astype(np.float64), axis=0)
        spread = np.maximum(np.median(np.abs(column - center), axis=0) * _STEEPNESS, 1e-9)
        least, most = (np.arcsinh((bound - center) / spread) for bound in (least, most))
        return Quantizer("sinh", _POSITION_STEPS, least, most, center, spread)
    if name == "base":
        low[3], high[3] = 0.0, 1.0
    return Quantizer("linear", _COLOR_STEPS, low, high)


def _canonical(name: str, column: Array) -> Array:
    """Unit quaternions with w >= 0; anything else as it is."""
    if name != "quaternions":
        return column
    unit = normalize(column)
    return np.where(unit[:, :1] < 0, -unit, unit)


def _steady(name: str, film: Array) -> Array:
    """(T, M, width) quantised frames, of which no quaternion jumps to the other of its two signs."""
    if name != "quaternions":
        return film
    film = film.copy()
    for frame in range(1, len(film)):
        before, now = (film[index].astype(np.int32) * 2 - _SHAPE_STEPS for index in (frame - 1, frame))
        flipped = (before * now).sum(1) < 0
        film[frame][flipped] = _SHAPE_STEPS - film[frame][flipped]
    return film


def _held(name: str, film: Array, seen: Array | None) -> Array:
    """(T, M, width) quantised frames whose numbers change only by more than _HELD steps and where they are seen.

    Args:
        seen: (T, M) where a Gaussian is; None for everywhere. Before that its numbers are those with which it appears.
    """
    shown = np.ones(film.shape, bool)
    if seen is not None:
        shown &= seen[..., None]
    if name == "base":
        shown[..., _OPACITY] = True
    first = np.argmax(shown, axis=0)
    now = np.take_along_axis(film, first[None], axis=0)[0]
    result = np.empty_like(film)
    for frame, values in enumerate(film):
        change = np.abs(values.astype(np.int32) - now) > _HELD
        now = np.where(change & shown[frame], values, now)
        result[frame] = now
    return result


def _described(name: str, quantizer: Quantizer, values: Array, *, film: bool) -> tuple[JsonObject, Array]:
    described: JsonObject = {"name": name, "film": film, "rows": values.shape[1], "width": values.shape[2]}
    return {**described, **quantizer.to_json()}, values


def _compressed(arrays: Sequence[Array]) -> bytes:
    """Of arrays of (T, M, width) integers the first frames, then frame by frame what changes in those of several.

    A frame's are stored number by number of a Gaussian, low bytes before high bytes.
    """
    blocks = [values[0] for values in arrays]
    films = [values for values in arrays if len(values) > 1]
    for frame in range(1, max((len(film) for film in films), default=0)):
        blocks += [film[frame] - film[frame - 1] for film in films]  # unsigned: wraps round, and back in the browser
    compressor = zlib.compressobj(9, memLevel=9, strategy=zlib.Z_FILTERED)
    parts = [
        compressor.compress(by_significance(np.ascontiguousarray(block.T).view(np.uint8), block.itemsize))
        for block in blocks
    ]
    return b"".join([*parts, compressor.flush()])


SCRIPTS = ("view.js", "splat_renderer.js", "headset.js", "page.js")
"""The page's own code, in the order in which it is put there."""
WORKER_SCRIPTS = ("scene.js", "worker.js")
MOST_CAMERAS = 64
"""That a page offers to look through."""
_FIELD_OF_VIEW = 50.0  # degrees across, where a scene has no camera
_POSTER_SIDE, _POSTER_QUALITY = 640, 60


PAGE, DATA = "index.html", "scene.bin"
"""Files of a page that is a folder."""
_PART = 15 * 2**13  # bytes of the data in one element: a page plays while others are on their way
_FIRST = 0x100  # of the characters that stand for 15 bits: from here on none is special, and none half of a pair


def write_page(path: Path, take: Take, *, folder: bool = False) -> Generator[int, None, None]:
    """Writes a take as a web page; yields how many frames are done. The file appears when all are.

    The capture is alone on its page, so that it does not matter where it was placed.

    Args:
        folder: whether ``path`` is a folder, in which the data lies beside the page: for servers.

    Raises:
        FrogError: for another ending, more than a browser holds, sound that cannot be read, or a file that cannot be
            written.
    """
    if not folder and path.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{path}: found the ending {path.suffix!r}, expected .html.")
    content, data = yield from packed(take)
    first = next(iter(take.frames())).gaussians
    cameras = spread(take.header.cameras, MOST_CAMERAS)
    camera, view = _first_view(cameras, first.means.astype(np.float64))
    numbers = take.numbers
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1.0
    description: JsonObject = {
        **content,
        "frames_per_second": take.rate / step,
        "background": list(take.header.background),
        "held": not take.keeps_identity,  # between frames: rows are other Gaussians in the next
        "cameras": [camera.to_json() for camera in cameras],
        "view": view,
    }
    sound = ""
    if take.sound is not None:
        ogg = encoded(take.sound, take.seconds)
        sound = f"data:audio/ogg;base64,{base64.b64encode(ogg).decode()}"
    if folder:
        write_atomically(path / DATA, data)
        description["source"] = f"{DATA}?{zlib.crc32(data):08x}"  # caches may hold another of that name
    values = {
        "title": html.escape(take.name),
        "sound": sound,
        "poster": _poster(take, first, camera),
        "policy": "; connect-src 'self'" if folder else "",
        # Nothing may end the element that it stands in.
        "description": json.dumps(description, allow_nan=False).replace("<", "\\u003c"),
        "data": "" if folder else _parts(data),
    }
    encoding = "utf-8" if folder else "utf-16"  # whose mark a browser believes, whatever a server says
    write_atomically(path / PAGE if folder else path, _filled(values).encode(encoding))


def _parts(data: bytes) -> str:
    """Elements that a page takes in as they come; a character of two bytes holds 15 bits of them."""
    bits = np.unpackbits(np.frombuffer(data + bytes(-len(data) % 15), np.uint8)).reshape(-1, 15)
    numbers = np.packbits(np.pad(bits, ((0, 0), (1, 0))), axis=1).view(">u2") + _FIRST
    text = numbers.astype("<u2").tobytes().decode("utf-16-le")
    size = _PART * 8 // 15
    texts = (text[begin : begin + size] for begin in range(0, len(text), size))
    return "\n".join(f'<script type="text/plain">{text}</script><script>arrived()</script>' for text in texts)


def _poster(take: Take, gaussians: NumpyGaussians, camera: Camera) -> str:
    """The first frame as a small image's address, for the time until a browser has drawn it, and where none can."""
    small = camera.scaled(min(1.0, _POSTER_SIDE / max(camera.width, camera.height)))
    cv2 = load_opencv()
    image = render_image(gaussians, small, take.header.background)[:, :, ::-1]
    _, content = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, _POSTER_QUALITY])
    return f"data:image/webp;base64,{base64.b64encode(content.tobytes()).decode()}"


def _filled(values: dict[str, str]) -> str:
    folder = files(__package__)

    def joined(names: Sequence[str]) -> str:
        return "\n".join((folder / name).read_text(encoding="utf-8") for name in names)

    values = values | {
        "projection": (files(rasterizer) / "projection.glsl").read_text(encoding="utf-8"),
        "worker": joined(WORKER_SCRIPTS),
        "scripts": joined(SCRIPTS),
    }
    return re.sub(r"{{(\w+)}}", lambda match: values[match[1]], joined(["page.html"]))


def _first_view(cameras: Sequence[Camera], means: Array) -> tuple[Camera, JsonObject]:
    """The camera that a page begins with, and what the view turns about, which way is up.

    With cameras it turns about the point nearest to all their optical axes, unless that is behind most of them.
    """
    middle = np.median(means, axis=0)
    up = np.array([0.0, -1.0, 0.0])  # of most files without cameras
    if cameras:
        up = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
        up = up / norm if (norm := float(np.linalg.norm(up))) > 1e-6 else np.array([0.0, 0.0, 1.0])
        point = nearest_to_axes(cameras)
        if point is not None and 2 * sum(c.rotation[2] @ (point - c.center) > 0 for c in cameras) > len(cameras):
            middle = point
    camera = cameras[0] if cameras else _from_afar(means, middle)
    return camera, {"target": middle.tolist(), "up": up.tolist(), "camera": camera.to_json()}


def _from_afar(means: Array, middle: Array) -> Camera:
    """Sees the most of a scene without cameras, along z and with y down, as most such files lie."""
    reach = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.8)) or 1.0
    focal = 500.0 / math.tan(math.radians(_FIELD_OF_VIEW / 2))
    pose = np.eye(4)
    pose[:3, 3] = np.array([0.0, 0.0, 2.5 * reach]) - middle
    return Camera("", 1000, 1000, np.array([[focal, 0.0, 500.0], [0.0, focal, 500.0], [0.0, 0.0, 1.0]]), pose)
