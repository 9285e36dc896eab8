"""Edits as a small JSON file, which the panel saves and ``frog render --edits`` reads.

An object with ``"frog_edits": 1`` and, each where there is something of it:

- ``"hidden"``: marks: ``{"count": Gaussians, "scene": identity of the scene file, "bits": zlib and base64}``, a bit for
  each Gaussian, the first in the highest bit of the first byte.
- ``"crops"``: a list of ``{"shape": "box" | "sphere" | "mesh", "matrix": 16 numbers, "keep": "inside" | "outside",
  "feather": world units, "time": in [0, 1], "vertices": numbers, "triangles": indices}``. The matrix, row by row, goes
  from the cube from -1 to 1, the unit sphere or the mesh to the scene's own coordinates. Without a time the place at
  the shown time counts. Vertices and triangles are a mesh's.
- ``"grades"``: a list of ``{"exposure", "contrast", "saturation", "temperature", "tint", "opacity", "size": numbers as
  in ``grades.Grade``, "gains", "offsets": 3 numbers, "only": marks}``; what is left out changes nothing.
- ``"time"``: ``{"start": frame number on a timeline, "rate": frames a second, "frames": of the capture, from 0}``, one
  for each frame that is rendered or exported; ``null`` at either end shows nothing.

Unknown names are refused: edits that are silently not made would be a lie.
"""

import json
from pathlib import Path

import numpy as np

from ..errors import FrogError, brief, found_instead
from ..io.atomic_files import write_atomically
from ..io.plain_values import JsonObject, UnfitValue, entries, items, number, numbers, plain_json, text, whole
from ..io.regular_file import read_text
from .closed_mesh import MOST_TRIANGLES, MOST_VERTICES, ClosedMesh
from .crops import MESH, Crop
from .edits import FASTEST_RATE, MOST_CROPS, MOST_FRAMES, MOST_GRADES, Edits, Timing
from .grades import RANGES, Grade
from .marks import MOST, Marks

KIND = "edits of a FRoG scene"
_VERSION = 1
_LARGEST_FILE = 1 << 26  # bytes
_LARGEST = 1e9  # of a coordinate
_BY_CHANNEL, _PLAIN = ("gains", "offsets"), Grade()


def save_edits(path: Path, edits: Edits) -> None:
    """Writes edits, whole or not at all; FrogError when they cannot be written, or could not be read again."""
    plain = to_json(edits)
    try:
        from_json(plain)
    except ValueError as error:
        raise FrogError(f"{path}: these edits could not be read again: found {error}.") from error
    content = (json.dumps(plain, indent=1, allow_nan=False) + "\n").encode()
    if len(content) > _LARGEST_FILE:
        raise found_instead(path, f"edits of {len(content):,} bytes", f"at most {_LARGEST_FILE:,}; simpler meshes")
    write_atomically(path, content)


def load_edits(path: Path) -> Edits:
    """What ``save_edits`` wrote; FrogError in one sentence for anything else."""
    content = read_text(path, KIND, _LARGEST_FILE)
    try:
        return from_json(plain_json(content, "a text"))
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    except (ValueError, OverflowError) as error:  # of values that do not fit together
        raise found_instead(path, error, KIND) from error


def to_json(edits: Edits) -> JsonObject:
    """Plain values for ``from_json``."""
    timing, grades = edits.timing, [_grade_json(grade) for grade in edits.grades if not grade.is_neutral]
    content: JsonObject = {
        "hidden": edits.hidden and _marks_json(edits.hidden),
        "crops": [_crop_json(crop) for crop in edits.crops],
        "grades": grades,
        "time": timing and {"start": timing.start, "rate": timing.rate, "frames": list(timing.frames)},
    }
    return {"frog_edits": _VERSION} | {name: value for name, value in content.items() if value}


def from_json(value: object) -> Edits:
    """Edits from plain values; ValueError (UnfitValue mostly) for what they cannot be."""
    named = _entries(value, "the content", "frog_edits", "hidden", "crops", "grades", "time")
    whole(named.get("frog_edits"), "frog_edits", _VERSION, _VERSION)
    return Edits(
        _marks(named["hidden"], "hidden") if "hidden" in named else None,
        tuple(_crop(item) for item in items(named.get("crops", []), "crops", MOST_CROPS)),
        tuple(_grade(item) for item in items(named.get("grades", []), "grades", MOST_GRADES)),
        _timing(named["time"]) if "time" in named else None,
    )


def _marks_json(marks: Marks) -> JsonObject:
    return {"count": marks.count, "scene": marks.scene, "bits": marks.to_text()}


def _crop_json(crop: Crop) -> JsonObject:
    content: JsonObject = {
        "shape": crop.shape,
        "matrix": list(crop.matrix),
        "keep": "inside" if crop.keep_inside else "outside",
        "feather": crop.feather or None,
        "time": crop.time,
        "vertices": crop.mesh and np.frombuffer(crop.mesh.vertices, "<f4").astype(np.float64).tolist(),
        "triangles": crop.mesh and np.frombuffer(crop.mesh.triangles, "<i4").tolist(),
    }
    return {name: value for name, value in content.items() if value is not None}


def _grade_json(grade: Grade) -> JsonObject:
    said = {name: getattr(grade, name) for name in (*RANGES, *_BY_CHANNEL)}
    changes = {name: value for name, value in said.items() if value != getattr(_PLAIN, name)}
    content: JsonObject = {name: list(value) if name in _BY_CHANNEL else value for name, value in changes.items()}
    return content | ({} if grade.only is None else {"only": _marks_json(grade.only)})


def _entries(value: object, what: str, *known: str) -> JsonObject:
    """An object of no other names than these."""
    named = entries(value, what)
    unknown = sorted(named.keys() - set(known))
    if unknown:
        raise UnfitValue(f"{what} with {unknown[0]!r}", f"only {', '.join(sorted(known))}")
    return named


def _marks(value: object, what: str) -> Marks:
    named = _entries(value, what, "count", "scene", "bits")
    count = whole(named.get("count"), f"{what}: count", 1, MOST)
    scene = text(named.get("scene"), f"{what}: scene", 64)
    return Marks.from_text(count, scene, text(named.get("bits"), f"{what}: bits", _LARGEST_FILE))


def _crop(value: object) -> Crop:
    named = _entries(value, "a crop", "shape", "matrix", "keep", "feather", "time", "vertices", "triangles")
    shape, keep = text(named.get("shape"), "a crop's shape", 64), named.get("keep", "inside")
    if keep not in ("inside", "outside"):
        raise UnfitValue(f"a crop that keeps {brief(keep)}", "inside or outside")
    matrix = numbers(named.get("matrix"), "a crop's matrix", (16,), _LARGEST)
    time = number(named["time"], "a crop's time", 0, 1) if "time" in named else None
    feather = number(named.get("feather", 0), "a crop's feather", 0, _LARGEST)
    mesh = _mesh(named) if shape == MESH or "vertices" in named or "triangles" in named else None
    return Crop(shape, tuple(matrix.tolist()), keep == "inside", feather, time, mesh)


def _mesh(named: JsonObject) -> ClosedMesh:
    vertices = items(named.get("vertices"), "vertices", 3 * MOST_VERTICES)
    triangles = items(named.get("triangles"), "triangles", 3 * MOST_TRIANGLES)
    points = numbers(vertices, "vertices", (len(vertices),), _LARGEST)
    corners = [whole(corner, "a triangle's vertex", 0, MOST_VERTICES) for corner in triangles]
    return ClosedMesh.of(points, np.array(corners, np.int64))


def _grade(value: object) -> Grade:
    named = _entries(value, "a grade", *RANGES, *_BY_CHANNEL, "only")
    settings: JsonObject = {}
    for name, setting in named.items():
        if name in RANGES:
            settings[name] = number(setting, f"a grade's {name}", *RANGES[name])
        elif name in _BY_CHANNEL:
            settings[name] = tuple(numbers(setting, f"a grade's {name}", (3,), 100).tolist())
        else:
            settings[name] = _marks(setting, "a grade's selection")
    return Grade(**settings)


def _timing(value: object) -> Timing:
    named = _entries(value, "a timing", "start", "rate", "frames")
    start = whole(named.get("start", 1), "a timing's start", -MOST_FRAMES, MOST_FRAMES)
    frames = [
        None if item is None else number(item, "a timing's frame", -_LARGEST, _LARGEST)
        for item in items(named.get("frames"), "frames", MOST_FRAMES)
    ]
    return Timing(tuple(frames), number(named.get("rate"), "a timing's rate", 0, FASTEST_RATE), start)
