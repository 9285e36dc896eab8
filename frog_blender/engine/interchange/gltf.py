"""glTF with ``KHR_gaussian_splatting``: one time's Gaussians as a binary ``.glb``. Numpy alone.

The extension (KhronosGroup/glTF, extensions/2.0/Khronos) stores linear sizes, opacities in [0, 1], quaternions x, y, z,
w and harmonics as 3DGS has them, and names the colour space: display-referred sRGB. Y is up. Written are floats; read
are floats and normalized whole numbers, of a ``.glb`` or of a ``.gltf`` with buffers in it or beside it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..arrays import Array, Float64s
from ..errors import FrogError, brief, found_instead
from ..gaussians import GaussianArrays, NumpyGaussians, joined
from ..io.atomic_files import write_atomically
from ..io.plain_values import JsonObject, UnfitValue, entries, items, numbers, text, whole
from ..io.regular_file import regular_file
from ..playback.transform import transform
from ..spherical_harmonics import SH_DC
from .activated import usable
from .gltf_buffers import BINARY, CHUNK, HEADER, JSON, MAGIC, opened
from .usd_source import Y_UP

EXTENSION = "KHR_gaussian_splatting"
_EXPECTED = f"a .glb or .gltf file with {EXTENSION}"
_POINTS, _FLOAT = 0, 5126
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", _FLOAT: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MOST_NODES, _DEEPEST, _MOST_PRIMITIVES = 65_536, 64, 4096
_FEWEST_BYTES = 4  # of a Gaussian: an eighth of what the smallest has, so that a mesh may stand in several places


def write_glb(path: Path, gaussians: NumpyGaussians) -> None:
    """Writes Gaussians with z up, atomically; FrogError when it cannot, and then an earlier file is untouched."""
    g = transform(gaussians, np.linalg.inv(Y_UP)).checked()
    color = np.clip(0.5 + SH_DC * g.sh[:, 0], 0, 1)
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    columns = {
        "POSITION": g.means,
        "COLOR_0": np.concatenate([linear, g.opacities[:, None]], axis=1),  # for those who draw points
        f"{EXTENSION}:SCALE": g.scales,
        f"{EXTENSION}:ROTATION": np.roll(g.quaternions, -1, axis=1),
        f"{EXTENSION}:OPACITY": g.opacities[:, None],
    }
    for degree in range(g.sh_degree + 1):
        for order in range(2 * degree + 1):
            columns[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"] = g.sh[:, degree**2 + order]
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    views, accessors, pieces, start = [], [], [], 0
    for index, values in enumerate(columns.values()):
        piece = np.ascontiguousarray(values, "<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(piece)})
        accessor = {"bufferView": index, "componentType": _FLOAT, "count": len(g), "type": kinds[values.shape[1]]}
        if not index:
            accessor |= {"min": g.means.min(axis=0).tolist(), "max": g.means.max(axis=0).tolist()}
        accessors.append(accessor)
        pieces.append(piece)
        start += len(piece)
    primitive = {
        "attributes": {name: place for place, name in enumerate(columns)},
        "mode": _POINTS,
        "extensions": {
            EXTENSION: {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "projection": "perspective",
                "sortingMethod": "cameraDistance",
            }
        },
    }
    document = {
        "asset": {"version": "2.0", "generator": "frog_blender"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    head = json.dumps(document).encode()
    head += b" " * (-len(head) % 4)
    size = HEADER.size + 2 * CHUNK.size + len(head) + start
    if size >= 2**32:
        raise FrogError(f"{path}: found {size:,} bytes of Gaussians, expected less than 4 GB, which a .glb can hold.")
    chunks = [HEADER.pack(MAGIC, 2, size), CHUNK.pack(len(head), JSON), head, CHUNK.pack(start, BINARY)]
    write_atomically(path, b"".join([*chunks, *pieces]))


def read_gltf(path: Path) -> tuple[NumpyGaussians, int]:
    """Gaussians with z up, and how many rows are left out that cannot be drawn; FrogError for any other file."""
    content = regular_file(path, _EXPECTED).read_bytes()
    try:
        return _Document(path, content).gaussians()
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error


class _Document:
    def __init__(self, path: Path, content: bytes) -> None:
        self._path = path
        self._json, self._buffers = opened(path, content)
        self._nodes, self._meshes = self._list("nodes"), self._list("meshes")
        self._accessors, self._views = self._list("accessors"), self._list("bufferViews")
        needed = items(self._json.get("extensionsRequired", []), "extensionsRequired", 1024)
        if others := [name for name in needed if name != EXTENSION]:
            raise UnfitValue(f"the required extension {brief(others[0])}", _EXPECTED)

    def gaussians(self) -> tuple[NumpyGaussians, int]:
        """Of all its primitives, where their nodes put them."""
        parts, left_out = [], 0
        # Several buffers may be the same bytes.
        contents = {id(buffer.obj): memoryview(buffer.obj).nbytes for buffer in self._buffers}
        room = most = sum(contents.values()) // _FEWEST_BYTES
        for primitive, matrix in self._placed():
            read = self._read(primitive)
            room -= len(read)  # nodes may share a mesh: a small file could ask for any number
            if room < 0:
                raise UnfitValue("a mesh in very many places", f"at most {most:,} Gaussians in all")
            found, without = usable(self._path, read, keep_rows=False)
            left_out += without
            try:
                parts.append(transform(found, Y_UP @ matrix))
            except FrogError as error:
                raise FrogError(f"{self._path}: {error}") from error
        if not parts:
            raise UnfitValue("no Gaussians", _EXPECTED)
        return joined(parts), left_out

    def _placed(self) -> list[tuple[JsonObject, Float64s]]:
        """The primitives that are Gaussians, and (4, 4) from their space to the world."""
        nodes, meshes = self._nodes, self._meshes
        children = [self._numbers_of(node, "children", len(nodes)) for node in nodes]
        below = {child for each in children for child in each}
        waiting = [(place, np.eye(4), 0) for place in range(len(nodes)) if place not in below]
        found: list[tuple[JsonObject, Float64s]] = []
        seen = 0
        while waiting:
            place, above, depth = waiting.pop()
            seen += 1
            if depth > _DEEPEST or seen > _MOST_NODES:
                raise UnfitValue("nodes below nodes without end", _EXPECTED)
            matrix = above @ _matrix(nodes[place])
            waiting += [(child, matrix, depth + 1) for child in children[place]]
            if "mesh" not in nodes[place]:
                continue
            mesh = meshes[whole(nodes[place]["mesh"], "a mesh", 0, len(meshes) - 1)]
            for item in items(mesh.get("primitives"), "primitives", _MOST_NODES):
                primitive = entries(item, "a primitive")
                if EXTENSION in entries(primitive.get("extensions", {}), "extensions"):
                    found.append((primitive, matrix))
            if len(found) > _MOST_PRIMITIVES:
                raise UnfitValue("Gaussians in very many parts", f"at most {_MOST_PRIMITIVES:,}")
        return found

    def _read(self, primitive: JsonObject) -> NumpyGaussians:
        extension = entries(entries(primitive["extensions"], "extensions")[EXTENSION], EXTENSION)
        if extension.get("extensions"):
            raise UnfitValue("compressed Gaussians", "plain ones")
        attributes = entries(primitive.get("attributes"), "attributes")
        means = self._accessor(attributes, "POSITION", 3)
        names = {"SCALE": 3, "ROTATION": 4, "OPACITY": 1}
        scales, turns, opacities = (self._accessor(attributes, f"{EXTENSION}:{n}", w) for n, w in names.items())
        colors = []
        for degree in range(4):
            name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_"
            if degree and f"{name}0" not in attributes:
                break
            colors += [self._accessor(attributes, f"{name}{order}", 3) for order in range(2 * degree + 1)]
        lengths = {len(array) for array in (means, scales, turns, opacities, *colors)}
        if len(lengths) != 1:
            raise UnfitValue(f"attributes of {brief(sorted(lengths))} Gaussians", "as many of each")
        return GaussianArrays(means, np.roll(turns, 1, axis=1), scales, opacities[:, 0], np.stack(colors, axis=1))

    def _accessor(self, attributes: JsonObject, name: str, width: int) -> Array:
        """(N, width) of an attribute."""
        accessors, views = self._accessors, self._views
        accessor = accessors[whole(attributes.get(name), f"the accessor of {name}", 0, len(accessors) - 1)]
        kind = whole(accessor.get("componentType"), f"the type of {name}", 0, 2**16)
        shape = text(accessor.get("type"), f"the shape of {name}", 16)
        if kind not in _TYPES or _WIDTHS.get(shape) != width:
            raise UnfitValue(f"{name} as {brief(shape)} of {brief(kind)}", f"{width} numbers each")
        if "sparse" in accessor or (kind != _FLOAT and accessor.get("normalized") is not True):
            raise UnfitValue(f"{name} sparse or in whole numbers", "floats, or normalized numbers")
        view = views[whole(accessor.get("bufferView"), f"the view of {name}", 0, len(views) - 1)]
        binary = self._buffers[whole(view.get("buffer"), "a buffer", 0, len(self._buffers) - 1)]
        dtype = np.dtype(_TYPES[kind])
        count = whole(accessor.get("count"), f"the count of {name}", 1, len(binary))
        begin = sum(whole(each.get("byteOffset", 0), "an offset", 0, len(binary)) for each in (view, accessor))
        stride = whole(view.get("byteStride", width * dtype.itemsize), "a stride", width * dtype.itemsize, 252)
        if begin + (count - 1) * stride + width * dtype.itemsize > len(binary):
            raise UnfitValue(f"{count:,} of {name} from byte {begin:,}", f"{len(binary):,} bytes")
        array = np.ndarray((count, width), dtype, binary, begin, (stride, dtype.itemsize)).astype(np.float32)
        return array if kind == _FLOAT else np.maximum(array / np.iinfo(dtype).max, -1)

    def _list(self, name: str) -> list[JsonObject]:
        return [entries(item, name) for item in items(self._json.get(name, []), name, _MOST_NODES)]

    @staticmethod
    def _numbers_of(node: JsonObject, name: str, count: int) -> list[int]:
        return [whole(item, name, 0, count - 1) for item in items(node.get(name, []), name, count)]


def _matrix(node: JsonObject) -> Float64s:
    """(4, 4) of a node, whose columns glTF writes one after the other."""
    if "matrix" in node:
        return numbers(node["matrix"], "a matrix", (16,), 1e12).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = numbers(node.get("rotation", [0, 0, 0, 1]), "a rotation", (4,), 1.001)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = turn * numbers(node.get("scale", [1, 1, 1]), "a scale", (3,), 1e12)
    matrix[:3, 3] = numbers(node.get("translation", [0, 0, 0]), "a translation", (3,), 1e12)
    return matrix
