"""Files of other programs, written as those programs do, for the tests of what reads them."""

import base64
import io
import json
import struct
import zipfile
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.interchange.gltf import glb_bytes
from frog_blender.engine.interchange.ply import splat_bytes
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.spherical_harmonics import SH_DC


def rgba(g: GaussianArrays) -> np.ndarray:
    """(N, 4) uint8."""
    color = np.concatenate([0.5 + SH_DC * g.sh[:, 0], g.opacities[:, None]], axis=1)
    return np.rint(color * 255).clip(0, 255).astype(np.uint8)


def smallest_three(g: GaussianArrays) -> tuple[np.ndarray, np.ndarray]:
    """(N,) which number of each turn is the largest, and (N, 3) the others where that is positive."""
    largest = np.abs(g.quaternions).argmax(axis=1)
    turns = g.quaternions * np.sign(g.quaternions[np.arange(len(g)), largest])[:, None]
    return largest, np.array([np.delete(turn, axis) for turn, axis in zip(turns, largest, strict=True)])


def compressed_ply(g: GaussianArrays) -> bytes:
    """A ``.compressed.ply`` of SuperSplat."""
    columns = np.concatenate([g.means, np.log(g.scales), 0.5 + SH_DC * g.sh[:, 0]], axis=1)
    group, names = np.arange(len(g)) // 256, [*"xyz", "scale_x", "scale_y", "scale_z", *"rgb"]
    starts = np.arange(0, len(g), 256)
    least, most = np.minimum.reduceat(columns, starts), np.maximum.reduceat(columns, starts)
    share = dict(zip(names, ((columns - least[group]) / (most - least)[group]).T, strict=True))

    def packed(shares: list[np.ndarray], bits: tuple[int, ...]) -> np.ndarray:
        number = np.zeros(len(g), np.uint64)
        for share, width in zip(shares, bits, strict=True):
            number = number << np.uint64(width) | np.rint(share * (2**width - 1)).astype(np.uint64)
        return number.astype("<u4")

    largest, others = smallest_three(g)
    vertex = {
        "packed_position": packed([share[axis] for axis in "xyz"], (11, 10, 11)),
        "packed_rotation": packed([largest / 3, *(others / np.sqrt(2) + 0.5).T], (2, 10, 10, 10)),
        "packed_scale": packed([share[f"scale_{axis}"] for axis in "xyz"], (11, 10, 11)),
        "packed_color": packed([*(share[color] for color in "rgb"), g.opacities], (8, 8, 8, 8)),
    }
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)
    head = ["ply", "format binary_little_endian 1.0", "comment SplatRenderMode: mip", f"element chunk {group[-1] + 1}"]
    head += [*(f"property float {end}_{name}" for end in ("min", "max") for name in names), f"element vertex {len(g)}"]
    head += [*(f"property uint {name}" for name in vertex), f"element sh {len(g)}"]
    head += [*(f"property uchar f_rest_{i}" for i in range(rest.shape[1])), "end_header", ""]
    tables = [np.concatenate([least, most], axis=1).astype("<f4"), np.stack([*vertex.values()], axis=1)]
    tables.append(np.floor((rest / 8 + 0.5) * 256).clip(0, 255).astype("u1"))
    return "\n".join(head).encode() + b"".join(table.tobytes() for table in tables)


def old_sog(content: bytes, folder: Path) -> Path:
    """A ``.sog`` file as a folder of its parts, with ranges in place of tables, as the first version had them."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
    meta = json.loads((folder / "meta.json").read_text())
    meta["means"]["shape"] = [meta.pop("count"), 3]
    del meta["version"], meta["antialias"], meta["shN"]["bands"]
    for name, width in (("scales", 3), ("sh0", 4), ("shN", 0)):
        low, *_, high = meta[name].pop("codebook")
        meta[name] |= {"mins": [low] * width or low, "maxs": [high] * width or high}
    meta["sh0"]["mins"][3:], meta["sh0"]["maxs"][3:] = [-5], [5]
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder


def splat(g: GaussianArrays) -> bytes:
    """A ``.splat`` file."""
    turns = np.rint(g.quaternions * 128 + 128).clip(0, 255).astype(np.uint8)
    rows = [np.concatenate([g.means, g.scales], axis=1).astype("<f4").view(np.uint8), rgba(g), turns]
    return np.concatenate(rows, axis=1).tobytes()


def sog(g: GaussianArrays) -> bytes:
    """A ``.sog`` file with a palette of as many rows as there are Gaussians."""
    import cv2

    count = len(g)

    def image(values: np.ndarray, width: int = 8) -> bytes:
        """Of (N, 4) uint8."""
        rows = -(-len(values) // width)
        pixels = np.zeros((rows * width, 4), np.uint8)
        pixels[: len(values)] = values
        bgra = pixels.reshape(rows, width, 4)[:, :, [2, 1, 0, 3]]
        done, content = cv2.imencode(".webp", bgra, [cv2.IMWRITE_WEBP_QUALITY, 101])
        assert done
        return content.tobytes()

    def opaque(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, np.full((len(values), 1), 255)], axis=1).astype(np.uint8)

    logarithms = np.sign(g.means) * np.log1p(np.abs(g.means))
    low, high = logarithms.min(axis=0), logarithms.max(axis=0)
    steps = np.rint((logarithms - low) / (high - low) * 65535).astype(np.int64)
    sizes = np.linspace(np.log(g.scales).min(), np.log(g.scales).max(), 256)
    colors = np.linspace(g.sh.min(), g.sh.max(), 256)

    def codes(values: np.ndarray, table: np.ndarray) -> np.ndarray:
        return np.abs(values[..., None] - table).argmin(axis=-1)

    largest, others = smallest_three(g)
    stored = np.rint((others * np.sqrt(2) + 1) / 2 * 255).clip(0, 255)
    width = g.sh.shape[1] - 1
    palette = np.zeros((64 * width * -(-count // 64), 3), np.int64)
    palette[: count * width] = codes(g.sh[:, 1:], colors).reshape(-1, 3)
    labels = np.stack([np.arange(count) % 256, np.arange(count) // 256, np.zeros(count)], axis=1)
    files = {
        "means_l.webp": image(opaque(steps & 255)),
        "means_u.webp": image(opaque(steps >> 8)),
        "quats.webp": image(np.concatenate([stored, 252 + largest[:, None]], axis=1).astype(np.uint8)),
        "scales.webp": image(opaque(codes(np.log(g.scales), sizes))),
        "sh0.webp": image(np.concatenate([codes(g.sh[:, 0], colors), rgba(g)[:, 3:]], axis=1).astype(np.uint8)),
        "centroids.webp": image(opaque(palette), 64 * width),
        "labels.webp": image(opaque(labels)),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "antialias": True,
        "count": count,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": sizes.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors.tolist(), "files": ["sh0.webp"]},
    }
    meta["shN"] = {"bands": {3: 1, 8: 2, 15: 3}[width], "codebook": colors.tolist()}
    meta["shN"] |= {"count": count, "files": ["centroids.webp", "labels.webp"]}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
        archive.writestr("meta.json", json.dumps(meta))
    return file.getvalue()


def zipped(scene: ScenePlayer, compression: int, counts: list[int] | None = None) -> bytes:
    """A zip of a scene's frames as ``.ply`` files, some with fewer Gaussians."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for frame in range(scene.header.frame_count):
            gaussians = scene.at_frame(frame)
            part = gaussians if counts is None else gaussians.part(slice(counts[frame]))
            archive.writestr(f"take/time_{frame + 5}.ply", splat_bytes(part))
        archive.writestr("__MACOSX/._time_5.ply", b"what a Mac puts there")
    return file.getvalue()


Columns = dict[str, np.ndarray]


def ply_columns(g: GaussianArrays) -> Columns:
    """Properties of a 3DGS file by name, float32."""
    header, _, body = splat_bytes(g).partition(b"end_header\n")
    names = [line.split()[-1] for line in header.decode().splitlines() if line.startswith("property")]
    return dict(zip(names, np.frombuffer(body, "<f4").reshape(len(g), -1).T.copy(), strict=True))


PLY_TYPES = {"<f2": "ushort", ">f2": "ushort", "<i2": "short", "<u2": "uint16", "u1": "uchar", "<i4": "int"}
PLY_TYPES |= {"<f4": "float", ">f4": "float", "<f8": "double", ">f8": "float64"}


def ply(columns: Columns, dtypes: dict[str, str] | str, kinds: str = "", extra: bool = False) -> bytes:
    """The columns as these types, each named as PLY names it, or all as ``kinds``; with ``extra`` elements around."""
    chosen = {name: dtypes if isinstance(dtypes, str) else dtypes.get(name, "<f4") for name in columns}
    table = np.empty(len(columns["x"]), [*chosen.items()])
    for name, values in columns.items():
        table[name] = values
    order = "big" if any(dtype.startswith(">") for dtype in chosen.values()) else "little"
    around = ["element chunk 2", "property uchar a", "property int16 b"] if extra else []
    after = ["element face 1", "property list uchar int vertex_index"] if extra else []
    lines = ["ply", f"format binary_{order}_endian 1.0", "comment made elsewhere", *around]
    lines += [
        f"element vertex {len(table)}",
        *(f"property {kinds or PLY_TYPES[chosen[name]]} {name}" for name in chosen),
    ]
    body = b"123456" * extra + table.tobytes() + b"\3" * 13 * extra
    return ("\r\n" if extra else "\n").join([*lines, *after, "end_header", ""]).encode() + body


def double_ply(g: GaussianArrays, offset: float = 5e6) -> bytes:
    """A big-endian ``.ply`` of float64 numbers, far from the origin, with a property that nobody needs."""
    columns = {name: column.astype(np.float64) for name, column in ply_columns(g).items()}
    return ply(columns | {"x": columns["x"] + offset, "object": np.full(len(g), 7)}, ">f8")


def gltf(g: GaussianArrays, beside: str | None = None) -> tuple[str, bytes]:
    """A ``.gltf`` text and its buffer, which lies beside it under that name, or is in the text if there is none."""
    content = glb_bytes(g)
    length = struct.unpack_from("<I", content, 12)[0]
    document, buffer = json.loads(content[20 : 20 + length]), content[20 + length + 8 :]
    packed = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    document["buffers"] = [{"byteLength": len(buffer), "uri": beside or packed}]
    return json.dumps(document, indent=1), buffer


def usd(g: GaussianArrays) -> str:
    """A ``.usda`` as nobody here writes it: y up, prims that move and are shared, samples of some attributes alone, and
    two cameras, one of which moves with what it hangs on."""

    def rows(values: np.ndarray, kind: str = "{:.6g}") -> str:
        if values.ndim == 1:
            return "[" + ", ".join(kind.format(value) for value in values) + "]"
        return "[" + ", ".join("(" + ", ".join(kind.format(value) for value in row) + ")" for row in values) + "]"

    numbers = {"orientations": g.quaternions, "scales": g.scales, "opacities": g.opacities}
    numbers |= {"first": g.means, "second": g.means + 0.1, "third": g.means + 0.2, "harmonics": g.sh.reshape(-1, 3)}
    text = Template(Path(__file__).with_name("foreign.usda").read_text())
    return text.substitute({name: rows(values) for name, values in numbers.items()}, degree=g.sh_degree)


CURVES = 60
_TRAINED = [*"xyz", "trbf_center", "trbf_scale", "nx", "ny", "nz", *(f"motion_{i}" for i in range(9))]
_TRAINED += [*(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
_TRAINED += [*(f"rot_{i}" for i in range(4)), *(f"omega_{i}" for i in range(4))]
"""Properties in the order of SpacetimeGaussians' lite model."""


def trained() -> Columns:
    """What a training could end with; no number is as half a float what it is as a whole one."""
    chance = np.random.default_rng(3)
    columns = {name: chance.normal(0, 1, CURVES).astype(np.float32) for name in _TRAINED}
    columns["trbf_center"] = chance.uniform(-0.1, 1.1, CURVES).astype(np.float32)
    columns["x"] = (chance.permutation(CURVES) / 9).astype(np.float32)  # which tells them apart
    columns |= {f"f_dc_{i}": chance.uniform(0, 1, CURVES).astype(np.float32) for i in range(3)}
    return columns | {f"rot_{i}": 3 * columns[f"rot_{i}"] for i in range(4)}  # of any length, as trained


def table(columns: Columns, name: str, count: int) -> np.ndarray:
    return np.stack([columns[f"{name}_{i}"] for i in range(count)], axis=1).astype(np.float64)


def splatv(columns: Columns, **changed: object) -> tuple[bytes, Columns]:
    """A file as splaTV's shader reads it, and what its smaller numbers say; a chunk of another kind comes first."""

    def halves(*values: np.ndarray) -> np.ndarray:
        """(N,) two halves of 32 bits, the first in the lower one."""
        low, high = (np.asarray(value, np.float16).view(np.uint16).astype(np.uint32) for value in values)
        return low | high << 16

    c, none = columns, np.zeros(CURVES, np.float32)
    sizes, width = np.exp(table(c, "scale", 3)), np.exp(c["trbf_scale"])
    alpha = 1 / (1 + np.exp(-c["opacity"]))
    rgba = np.rint(255 * np.stack([*table(c, "f_dc", 3).T, alpha])).astype(np.uint32)
    texture = np.zeros((1024, 16), np.uint32)  # a whole row of 4,096 pixels
    texture[:CURVES] = np.stack(
        [
            *(c[axis].view(np.uint32) for axis in "xyz"),
            *(halves(c["rot_0"], c["rot_1"]), halves(c["rot_2"], c["rot_3"])),
            *(halves(sizes[:, 0], sizes[:, 1]), halves(sizes[:, 2], none)),
            rgba[0] | rgba[1] << 8 | rgba[2] << 16 | rgba[3] << 24,
            *(halves(c[f"motion_{i}"], c[f"motion_{i + 1}"] if i < 8 else none) for i in range(0, 9, 2)),
            *(halves(c["omega_0"], c["omega_1"]), halves(c["omega_2"], c["omega_3"])),
            halves(c["trbf_center"], width),
        ],
        axis=1,
    )
    chunk = {"type": "splat", "size": texture.nbytes, "texwidth": 4096, "texheight": 1, "cameras": []} | changed
    text = json.dumps([{"type": "other", "size": 5}, chunk]).encode()
    said = {name: column.astype(np.float16).astype(np.float32) for name, column in c.items() if name not in "xyz"}
    said |= {"trbf_scale": np.log(width.astype(np.float16).astype(np.float64)), **{axis: c[axis] for axis in "xyz"}}
    said |= {f"scale_{i}": np.log(sizes[:, i].astype(np.float16).astype(np.float32)) for i in range(3)}
    said |= {f"f_dc_{i}": rgba[i] / 255 for i in range(3)}
    said["opacity"] = np.log(rgba[3] / (255 - rgba[3]))
    return struct.pack("<II", 0x674B, len(text)) + text + b"other" + texture.tobytes(), said
