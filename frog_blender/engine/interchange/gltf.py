"""glTF with ``KHR_gaussian_splatting``: one time's Gaussians as a binary ``.glb``. Numpy alone.

The extension (KhronosGroup/glTF, extensions/2.0/Khronos) stores linear sizes, opacities in [0, 1], quaternions x, y, z,
w and harmonics as 3DGS has them, and names the colour space: display-referred sRGB. Y is up. Written are floats; read
are floats and whole numbers, of a ``.glb`` or of a ``.gltf`` with buffers in it or beside it, and what its extensions
for ``.spz`` hold. Linear colours become sRGB. Of several scenes the one that the
file shows is read.
"""

import json
import struct
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from ..arrays import Array, Float64s
from ..errors import brief
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.paths import read_beside
from ..io.plain_values import JsonObject, UnfitValue, entries, items, numbers, plain_json, text, whole
from ..playback.transform import rotations_of, transform
from ..spherical_harmonics import SH_DC
from ..srgb import srgb_to_linear
from .spz import decode_spz
from .stills import LINEAR, Y_UP, Part, display_referred

EXTENSION = "KHR_gaussian_splatting"
EXPECTED = f"a .glb or .gltf file with {EXTENSION}"
_LINEAR = "lin_rec709_display", "linear"
_KNOWN = {
    "kernel": ("ellipse",),
    "colorSpace": ("srgb_rec709_display", "BT.709", *_LINEAR),
    "projection": ("perspective",),
    "sortingMethod": ("cameraDistance", "zDepth"),
}
"""What is read; what stands first is written, and meant where a file does not say it. "BT.709", "linear" and "zDepth"
are words of the extension's drafts."""
_MEANING = {name: known[0] for name, known in _KNOWN.items()}
_SPZ = "KHR_gaussian_splatting_compression_spz_2", "KHR_gaussian_splatting_compression_spz"
_VISIBILITY = "KHR_node_visibility"
_UNCHANGING = "KHR_materials_", "KHR_xmp"  # extensions that change no Gaussian
_READ = (EXTENSION, *_SPZ, "KHR_mesh_quantization", _VISIBILITY)
_NOT_SHOWN = "Some of its Gaussians are left out: they are hidden, or not in the scene that it shows."
_QUANTIZED = "POSITION", f"{EXTENSION}:SCALE"  # that may be whole numbers as they are
_LUF = np.diag([-1.0, 1.0, -1.0, 1.0])
"""From the axes of .spz to those that the extension for it has its content in."""
_GLTF = "a glTF 2.0 file"
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_HEADER, _CHUNK = struct.Struct("<III"), struct.Struct("<II")
_POINTS, _FLOAT, _VERTICES = 0, 5126, 34962
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", _FLOAT: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MOST_NODES, _MOST_PRIMITIVES = 65_536, 4096
_FEWEST_BYTES = 4  # of a Gaussian: an eighth of what the smallest has, so that a mesh may stand in several places
_LONGEST_JSON, _LARGEST = 64 << 20, 4 << 30  # bytes, of all buffers together as well
_MOST_BUFFERS = 1024
_DATA = ("data:application/octet-stream;base64", "data:application/gltf-buffer;base64")


def glb_bytes(gaussians: NumpyGaussians) -> bytes:
    """A binary file of Gaussians with z up; UnfitValue for more than it can hold."""
    g = transform(gaussians, np.linalg.inv(Y_UP))
    color = np.clip(0.5 + SH_DC * g.sh[:, 0], 0, 1)
    columns = {
        "POSITION": g.means,
        "COLOR_0": np.concatenate([srgb_to_linear(color), g.opacities[:, None]], axis=1),  # for those who draw points
        f"{EXTENSION}:SCALE": g.scales,
        f"{EXTENSION}:ROTATION": np.roll(g.quaternions, -1, axis=1),
        f"{EXTENSION}:OPACITY": g.opacities[:, None],
    }
    for degree in range(g.sh_degree + 1):
        for order in range(2 * degree + 1):
            columns[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"] = g.sh[:, degree**2 + order]
    kinds = {width: kind for kind, width in _WIDTHS.items()}
    views, accessors, pieces, start = [], [], [], 0
    for index, values in enumerate(columns.values()):
        piece = np.ascontiguousarray(values, "<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(piece), "target": _VERTICES})
        accessor = {"bufferView": index, "componentType": _FLOAT, "count": len(g), "type": kinds[values.shape[1]]}
        if not index:
            accessor |= {"min": g.means.min(axis=0).tolist(), "max": g.means.max(axis=0).tolist()}
        accessors.append(accessor)
        pieces.append(piece)
        start += len(piece)
    attributes = {name: index for index, name in enumerate(columns)}
    primitive = {"attributes": attributes, "mode": _POINTS, "extensions": {EXTENSION: _MEANING}}
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
    size = _HEADER.size + 2 * _CHUNK.size + len(head) + start
    if size >= 2**32:
        raise UnfitValue(f"{size:,} bytes of Gaussians", "less than 4 GB, which a .glb can hold")
    chunks = [_HEADER.pack(_MAGIC, 2, size), _CHUNK.pack(len(head), _JSON), head, _CHUNK.pack(start, _BINARY)]
    return b"".join([*chunks, *pieces])


def decode_gltf(path: Path, content: bytes) -> Iterator[Part]:
    """The primitives that are Gaussians, and where their nodes put them, with z up; UnfitValue for any other content.

    Args:
        path: of the file, beside which its buffers may lie.
    """
    document = _Document(path, content)
    contents = {id(buffer.obj): memoryview(buffer.obj).nbytes for buffer in document.buffers}  # several may be the same
    room = most = sum(contents.values()) // _FEWEST_BYTES
    placed, leaves_out = document.placed()
    for primitive, matrix, unread in placed:
        part = document.read(primitive)
        room -= len(part.gaussians)  # nodes may share a mesh: a small file could ask for any number
        if room < 0:
            raise UnfitValue("a mesh in very many places", f"at most {most:,} Gaussians in all")
        said = [f"Not read, and so not seen: {', '.join(map(brief, sorted(unread)))}."] if unread else []
        notes = (*part.notes, *said, *([_NOT_SHOWN] if leaves_out else []))
        yield part._replace(matrix=Y_UP @ matrix @ part.matrix, notes=notes)
    if room == most:
        raise UnfitValue("no Gaussians in what it shows" if leaves_out else "no Gaussians", EXPECTED)


def _is_read(extension: str) -> bool:
    return extension in _READ or extension.startswith(_UNCHANGING)


def _splats_of(mesh: JsonObject) -> list[JsonObject]:
    """The primitives of a mesh that are Gaussians."""
    primitives = (entries(item, "a primitive") for item in items(mesh.get("primitives"), "primitives", _MOST_NODES))
    return [one for one in primitives if EXTENSION in entries(one.get("extensions", {}), "extensions")]


class _Document:
    def __init__(self, path: Path, content: bytes) -> None:
        own: memoryview | None = None
        if content.startswith(_MAGIC.to_bytes(4, "little")):
            content, own = _chunks(content)
        if len(content) > _LONGEST_JSON:
            raise UnfitValue(f"a description of {len(content):,} bytes", f"at most {_LONGEST_JSON:,}")
        document = entries(plain_json(content.decode("utf-8-sig"), "a description"), "a description")
        version = entries(document.get("asset"), "asset").get("version")
        if not str(version).startswith("2."):
            raise UnfitValue(f"version {brief(version)}", _GLTF)
        needed = items(document.get("extensionsRequired", []), "extensionsRequired", 1024)
        if others := [name for name in needed if not _is_read(str(name))]:
            raise UnfitValue(f"the required extension {brief(others[0])}", EXPECTED)
        self.buffers = _buffers(path, document, own)
        self._lists = {
            name: [entries(item, name) for item in items(document.get(name, []), name, _MOST_NODES)]
            for name in ("nodes", "meshes", "accessors", "bufferViews", "scenes")
        }
        self._scene = document.get("scene", 0)
        self._moves = {"animations"} if document.get("animations") else set[str]()

    def _item(self, name: str, index: object, what: str) -> JsonObject:
        return self._lists[name][whole(index, what, 0, len(self._lists[name]) - 1)]

    def placed(self) -> tuple[list[tuple[JsonObject, Float64s, set[str]]], bool]:
        """The primitives that are Gaussians in the scene that is shown, with (4, 4) from their space to the world and
        what of them is not read; and whether there are others."""
        nodes, placed, shown = self._lists["nodes"], [], set[int]()
        splats = [_splats_of(self._item("meshes", node["mesh"], "a mesh")) if "mesh" in node else [] for node in nodes]
        children = [self._nodes(node, "children") for node in nodes]
        below = {child for siblings in children for child in siblings}
        roots = [index for index in range(len(nodes)) if index not in below]
        if self._lists["scenes"]:
            roots = self._nodes(self._item("scenes", self._scene, "the scene"), "nodes")
        waiting = [(root, np.eye(4)) for root in roots]
        while waiting:
            index, above = waiting.pop()
            if index in shown:
                raise UnfitValue("a node below two others, or itself", EXPECTED)
            node = nodes[index]
            extensions = entries(node.get("extensions", {}), "extensions")
            if entries(extensions.get(_VISIBILITY, {}), _VISIBILITY).get("visible") is False:
                continue
            shown.add(index)
            matrix = above @ _matrix(node)
            waiting += [(child, matrix) for child in children[index]]
            for primitive in splats[index]:
                unread = {*extensions, *primitive["extensions"], *({"skin", "targets"} & {*node, *primitive})}
                placed.append((primitive, matrix, {name for name in unread if not _is_read(name)} | self._moves))
                if len(placed) > _MOST_PRIMITIVES:
                    raise UnfitValue("Gaussians in very many parts", f"at most {_MOST_PRIMITIVES:,}")
        return placed, any(splats[index] for index in range(len(nodes)) if index not in shown)

    def _nodes(self, said: JsonObject, name: str) -> list[int]:
        most = len(self._lists["nodes"])
        return [whole(index, name, 0, most - 1) for index in items(said.get(name, []), name, most)]

    def read(self, primitive: JsonObject) -> Part:
        """With y up."""
        extension = entries(entries(primitive["extensions"], "extensions")[EXTENSION], EXTENSION)
        for name, known in _KNOWN.items():
            if extension.get(name, _MEANING[name]) not in known:
                raise UnfitValue(f"{name} = {brief(extension[name])}", f"one of {', '.join(known)}")
        own = entries(extension.get("extensions", {}), "extensions")
        if others := [name for name in own if name not in _SPZ]:
            raise UnfitValue(f"Gaussians with {brief(others[0])}", f"plain ones, or with {_SPZ[0]}")
        part = Part(self._plain(primitive), np.eye(4)) if not own else self._spz(extension, own[min(own)])
        if extension.get("colorSpace") in _LINEAR:
            return part._replace(gaussians=display_referred(part.gaussians), notes=(*part.notes, LINEAR))
        return part

    def _spz(self, extension: JsonObject, packed: object) -> Part:
        """Of a .spz file in the buffers. Files of the drafts, without a kernel, have its numbers as they are."""
        part = decode_spz(Path(), bytes(self._view(entries(packed, _SPZ[0]), "SPZ")[0]))[0]
        return part._replace(matrix=(_LUF if "kernel" in extension else np.eye(4)) @ np.linalg.inv(Y_UP) @ part.matrix)

    def _plain(self, primitive: JsonObject) -> NumpyGaussians:
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
        accessor = self._item("accessors", attributes.get(name), f"the accessor of {name}")
        kind = whole(accessor.get("componentType"), f"the type of {name}", 0, 2**16)
        shape = text(accessor.get("type"), f"the shape of {name}", 16)
        if kind not in _TYPES or _WIDTHS.get(shape) != width:
            raise UnfitValue(f"{name} as {brief(shape)} of {brief(kind)}", f"{width} numbers each")
        is_exact = kind == _FLOAT or (name in _QUANTIZED and accessor.get("normalized") is not True)
        if "sparse" in accessor or not (is_exact or accessor.get("normalized") is True):
            raise UnfitValue(f"{name} sparse or in whole numbers", "floats, or normalized numbers")
        binary, view = self._view(accessor, name)
        dtype = np.dtype(_TYPES[kind])
        count = whole(accessor.get("count"), f"the count of {name}", 1, len(binary))
        begin = whole(accessor.get("byteOffset", 0), "an offset", 0, len(binary))
        stride = whole(view.get("byteStride", width * dtype.itemsize), "a stride", width * dtype.itemsize, 252)
        if begin + (count - 1) * stride + width * dtype.itemsize > len(binary):
            raise UnfitValue(f"{count:,} of {name} from byte {begin:,}", f"{len(binary):,} bytes")
        array = np.ndarray((count, width), dtype, binary, begin, (stride, dtype.itemsize)).astype(np.float32)
        return array if is_exact else np.maximum(array / np.iinfo(dtype).max, -1)

    def _view(self, said: JsonObject, name: str) -> tuple[memoryview, JsonObject]:
        """The bytes that something lies in, and how they are described."""
        view = self._item("bufferViews", said.get("bufferView"), f"the view of {name}")
        binary = self.buffers[whole(view.get("buffer"), "a buffer", 0, len(self.buffers) - 1)]
        begin = whole(view.get("byteOffset", 0), "an offset", 0, len(binary))
        length = whole(view.get("byteLength"), f"the bytes of {name}", 1, len(binary) - begin)
        return binary[begin : begin + length], view


def _matrix(node: JsonObject) -> Float64s:
    """(4, 4) of a node, whose columns glTF writes one after the other."""
    if "matrix" in node:
        return numbers(node["matrix"], "a matrix", (16,), 1e12).reshape(4, 4).T
    matrix = np.eye(4)
    turn = numbers(node.get("rotation", [0, 0, 0, 1]), "a rotation", (4,), 1.001)
    if not turn.any():
        raise UnfitValue("a rotation of no direction", "a quaternion")
    rotation = rotations_of(np.roll(turn, 1)[None])[0]
    matrix[:3, :3] = rotation * numbers(node.get("scale", [1, 1, 1]), "a scale", (3,), 1e12)
    matrix[:3, 3] = numbers(node.get("translation", [0, 0, 0]), "a translation", (3,), 1e12)
    return matrix


def _chunks(content: bytes) -> tuple[bytes, memoryview | None]:
    """The description and the buffer of a binary file."""
    _, version, size = _HEADER.unpack_from(content.ljust(_HEADER.size, b"\0"))
    if version != 2 or size > len(content):
        raise UnfitValue("no binary glTF 2.0, or a part of one", _GLTF)
    chunks: dict[int, memoryview] = {}
    at, whole_file = _HEADER.size, memoryview(content)
    while at + _CHUNK.size <= size and len(chunks) < 2:
        length, kind = _CHUNK.unpack_from(content, at)
        at += _CHUNK.size
        if at + length > size:
            raise UnfitValue(f"a chunk of {length:,} bytes at {at:,} of {size:,}", _GLTF)
        chunks[kind] = whole_file[at : at + length]
        at += length
    if _JSON not in chunks:
        raise UnfitValue("no description", _GLTF)
    return bytes(chunks[_JSON]), chunks.get(_BINARY)


def _buffers(path: Path, document: JsonObject, own: memoryview | None) -> list[memoryview]:
    """Of a description; one beside the file is read from its own folder or one below, never from another place."""
    buffers: list[memoryview] = []
    files: dict[str, memoryview] = {}  # however often one is named, it is read once
    room = _LARGEST
    for index, item in enumerate(items(document.get("buffers"), "buffers", _MOST_BUFFERS)):
        buffer = entries(item, "a buffer")
        size = whole(buffer.get("byteLength"), "the size of a buffer", 1, _LARGEST)
        if "uri" not in buffer:
            if index or own is None:
                raise UnfitValue("a buffer that is nowhere", _GLTF)
            content = own
        else:
            name = text(buffer["uri"], "where a buffer is", _LONGEST_JSON)
            if name not in files:
                kind, _, data = name.partition(",")
                if name.startswith("data:") and kind not in _DATA:
                    raise UnfitValue(f"a buffer written as {brief(name[:60])}", "bytes in base64")
                is_here = kind in _DATA
                read = b64decode(data, validate=True) if is_here else read_beside(path, unquote(name), "a buffer", room)
                files[name] = memoryview(read)
                room -= len(read)
            content = files[name]
        if len(content) < size:
            raise UnfitValue(f"a buffer of {len(content):,} bytes", f"the {size:,} that are announced")
        buffers.append(content[:size])
    return buffers
