"""3DGS ``.ply`` files: the Gaussians of one time in the layout that splat viewers share. Numpy alone.

``x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3``: opacities as logits, scales as logarithms,
quaternions w, x, y, z, ``f_rest`` by channel (all of red, then green, then blue). Written as little-endian float32;
read in either byte order or as text, in any order of properties, and floats of 16 (which PLY can only name whole
numbers), 32 and 64 bits. Bytes of red, green and blue stand in for ``f_dc`` where that is missing. No file says which
way is up: see interchange.frame_files.

SpacetimeGaussians' trained files have ``motion_0..8 omega_0..3 trbf_center trbf_scale`` besides, of which CURVES are
made: frame k of n is at the time k / n. Of its lite model, ``f_dc`` are colours from 0 to 1.

plyfile was tried for this. Its current release wants numpy 2, which Blender 4.5 and 5.0 do not have; and for lists
before the vertices, text, or a header without an end it asks for what the file says (30 GB for 200 bytes; 86 s for
100 MB), so the header has to be checked before it sees a file. Then one call of numpy is left to do. The tests read
with it what is written here.
"""

import itertools
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..arrays import Array, SceneArrays
from ..capture.world import FILES_OWN, World
from ..errors import found_instead, in_words
from ..field.names import CURVES
from ..gaussians import LOW_PASS, WIDEST_LOW_PASS, NumpyGaussians
from ..io.regular_file import regular_file
from ..playback.frame_delta import canonical_arrays, canonical_gaussians
from ..scene.quantization import morton_order
from ..spherical_harmonics import SH_DC
from .frame_source import CurveSource, StillSource
from .stills import ANTIALIASED, bounded, completed, largest_and_others, units

_EXPECTED = "a 3DGS .ply"
_MEANING = "logarithms of sizes, logits of opacities and the like, as 3DGS trainings write them"
_LARGEST_SIZE = 27.0  # a logarithm: the rasterizer draws none of 1e12 or more
_USUAL_SIZE = 20.0  # more, and the numbers are no logarithms
_THINNEST = -30.0  # logarithm that stands for that of a size of zero, which some programs write for flat Gaussians
_MOST_CERTAIN = 30.0  # logit that stands for an infinite one, which some programs write for an opacity of one
LONGEST_HEADER = 1 << 16
"""Bytes of a file by which its header ends."""
_COARSE = 0.01  # of a Gaussian's size: by so much single precision may move it
_MAX_ORIGIN = 1e12  # world units
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}
_CODES = ("i1", "u1", "i2", "u2", "i4", "u4", "f2", "f4", "f8")
_TYPES = dict(zip(["char", "uchar", "short", "ushort", "int", "uint", "half", "float", "double"], _CODES, strict=True))
_TYPES |= {np.dtype(code).name: code for code in _CODES}
"""numpy's types by the format's names, old and new."""
_COUNT = re.compile(r"[0-9]{1,12}")
_SHARED = 256  # Gaussians of a compressed file that share a chunk
_PACKED = {"position": (11, 10, 11), "rotation": (2, 10, 10, 10), "scale": (11, 10, 11), "color": (8, 8, 8, 8)}
"""Bits of the numbers that lie in one of 32."""
_RANGED = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
_RANGES = [f"{end}_{name}" for names in _RANGED for end in ("min", "max") for name in names]
"""Of which the last six may be missing."""
_RGB = ("red", "green", "blue")
_COLORS, _SIZES, _TURNS = ([f"{name}_{i}" for i in range(n)] for name, n in (("f_dc", 3), ("scale", 3), ("rot", 4)))
_TABLES = ("vertex", "chunk", "sh")
_TEXT = re.compile(r"^format\s+ascii\b", re.MULTILINE)
_NO_LOGITS = "All opacities lie between 0 and 1 and were taken for logits; if they are none, it is too transparent."
_NO_LOGARITHMS = "No size has a negative number; all were taken for logarithms. If they are none, it is too large."
_NO_DURATION = f"The file does not say how long it lasts; it was taken for {CurveSource.frame_count} frames."
_OWN_LOW_PASS = re.compile(r"^comment frog: low-pass (\d{1,3}(?:\.\d{1,6})?)\s*$", re.MULTILINE)
_ANTIALIASED = re.compile(r"^comment (antialiased 1|splatrendermode: mip)\s*$", re.IGNORECASE | re.MULTILINE)
_RESTS = {0: 1, 9: 4, 24: 9, 45: 16}  # f_rest properties -> SH coefficients a channel


PROMISE = "comment frog: the same row is the same Gaussian in every file of this sequence"
"""Line of a header by which a sequence says that its count and order are constant: players interpolate such frames."""


def splat_bytes(gaussians: NumpyGaussians, *, promise: bool = False) -> bytes:
    """A file of Gaussians as they are.

    Args:
        promise: say that the file is one of a sequence whose count and order are constant.
    """
    g = gaussians.checked()
    rest = _by_channel(g)
    a = canonical_arrays(g)
    names = [*"xyz", "nx", "ny", "nz", *_COLORS, *(f"f_rest_{i}" for i in range(rest.shape[1]))]
    names += ["opacity", *_SIZES, *_TURNS]
    columns = [g.means, np.zeros_like(g.means), g.sh[:, 0], rest, a["opacity_logits"][:, None], a["log_scales"]]
    columns.append(g.quaternions)
    table = np.concatenate(columns, axis=1).astype("<f4")
    return _file([PROMISE] if promise else [], g, ("vertex", "float", names, table))


def compressed_bytes(gaussians: NumpyGaussians) -> bytes:
    """A compressed file, see ``_unpacked``, of Gaussians along a curve through space: few lie far from each other in a
    chunk."""
    g = gaussians.checked()
    g = g.part(morton_order(g.means))
    sizes = canonical_arrays(g)["log_scales"].clip(-_USUAL_SIZE, _USUAL_SIZE)
    columns = np.stack([g.means, sizes, (g.sh[:, 0] * SH_DC + 0.5)], axis=1)  # (N, 3, 3)
    starts = np.arange(0, len(g), _SHARED)
    ends = np.stack([end.reduceat(columns, starts) for end in (np.minimum, np.maximum)], axis=2)
    low, high = np.repeat(ends, _SHARED, axis=0)[: len(g)].transpose(2, 0, 1, 3)
    places, sizes, colors = ((columns - low) / np.maximum(high - low, 1e-30)).transpose(1, 0, 2)
    largest, others = largest_and_others(g.quaternions)
    turns = np.column_stack([largest / 3, others / math.sqrt(2) + 0.5])
    shares = (places, turns, sizes, np.column_stack([colors, g.opacities]))
    packed = [_packed(each, *bits) for each, bits in zip(shares, _PACKED.values(), strict=True)]
    rest = np.floor(_by_channel(g) * 32 + 128).clip(0, 255).astype(np.uint8)
    tables: list[tuple[str, str, list[str], Array]] = [
        ("chunk", "float", _RANGES, ends.astype("<f4")),
        ("vertex", "uint", [f"packed_{name}" for name in _PACKED], np.stack(packed, axis=1).astype("<u4")),
    ]
    if rest.size:
        tables.append(("sh", "uchar", [f"f_rest_{index}" for index in range(rest.shape[1])], rest))
    return _file([], g, *tables)


def _packed(shares: Array, *bits: int) -> Array:
    """(N,) whole numbers of so many bits each, of (N, C) from 0 to 1."""
    whole = np.zeros(len(shares), np.int64)
    for column, width in zip(shares.T, bits, strict=True):
        whole = whole << width | np.rint(column * (2**width - 1)).astype(np.int64)
    return whole


def _shares(packed: Array, *bits: int) -> Array:
    """The other way round."""
    return np.stack([(packed >> sum(bits[i + 1 :]) & 2**n - 1) / (2**n - 1) for i, n in enumerate(bits)], axis=1)


def _by_channel(g: NumpyGaussians) -> Array:
    """(N, C) the harmonics from degree 1 on: all of red, then green, then blue."""
    return g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)


def _file(comments: list[str], g: NumpyGaussians, *tables: tuple[str, str, list[str], Array]) -> bytes:
    """Of elements' names, types, properties and numbers."""
    if not np.array_equal(g.low_pass, LOW_PASS):
        comments.append(f"comment frog: low-pass {np.max(g.low_pass):g}")
    lines = ["ply", "format binary_little_endian 1.0", *comments]
    for element, kind, names, table in tables:
        lines += [f"element {element} {len(table)}", *(f"property {kind} {name}" for name in names)]
    return "\n".join([*lines, "end_header\n"]).encode() + b"".join(table.tobytes() for *_, table in tables)


def read_splats(path: str | Path) -> StillSource:
    """The Gaussians of a file, with its numbers as ``arrays``; no more memory than a few times its size is taken.

    FrogError in one sentence for anything but a whole 3DGS ``.ply``.
    """
    with in_words(f"{path}: could not be read"), regular_file(path, _EXPECTED).open("rb") as file:
        return splats_in(path, file)


def splats_in(path: str | Path, file: BinaryIO) -> StillSource:
    """As ``read_splats``, of an open file; ``path`` is what the sentence names."""
    start, elements, comments = _layout(path, file)
    there = file.seek(0, 2)
    tables: dict[str, Array] = {}
    if _TEXT.search(comments):
        file.seek(start)
        tables, elements = _in_words(path, file.read(), elements), {}
    for name, (count, dtype) in elements.items():
        size = count * dtype.itemsize
        if name in _TABLES:
            file.seek(start)
            content = file.read(min(size, max(there - start, 0)))
            if len(content) < size:
                raise found_instead(path, f"{len(content):,} bytes of {name}", f"the {size:,} that it announces")
            tables[name] = np.frombuffer(content, dtype, count)
        start += size
    kinds = dict(tables["vertex"].dtype.fields or {})
    if all(kinds.get(f"packed_{name}", " ")[0] == "u4" for name in _PACKED):
        tables["vertex"] = _unpacked(path, **tables)
    source = splats_of(path, tables["vertex"])
    if (said := _OWN_LOW_PASS.search(comments)) and float(said[1]) <= WIDEST_LOW_PASS:
        source.gaussians.low_pass = float(said[1])
    return replace(source, notes=(*source.notes, ANTIALIASED)) if _ANTIALIASED.search(comments) else source


def _in_words(path: str | Path, content: bytes, elements: dict[str, tuple[int, np.dtype[np.void]]]) -> dict[str, Array]:
    """The tables of a text file; FrogError for fewer numbers than it announces."""
    try:
        numbers: Array = np.fromstring(content, np.float64, sep=" ")
    except (ValueError, DeprecationWarning):  # words that are no numbers
        numbers = np.empty(0)
    tables: dict[str, Array] = {}
    for name, (count, dtype) in elements.items():
        width = len(dtype.names or ())
        if len(numbers) < count * width:
            raise found_instead(path, f"fewer numbers than the {count * width:,} of its {name}", _EXPECTED)
        rows, numbers = np.split(numbers, [count * width])
        with np.errstate(over="ignore", invalid="ignore"):  # see _splats
            tables[name] = np.rec.fromarrays([*rows.reshape(count, width).T], dtype=dtype)
    return tables


def _layout(path: str | Path, file: BinaryIO) -> tuple[int, dict[str, tuple[int, np.dtype[np.void]]], str]:
    """Byte at which the content begins; of the elements up to the vertices and those behind that are known how many
    rows there are, and the structure of one; and the header."""
    head = file.read(LONGEST_HEADER)
    if not head.startswith((b"ply\n", b"ply\r\n")):
        raise found_instead(path, "no PLY file", _EXPECTED)
    end = head.find(b"\nend_header")
    line_end = head.find(b"\n", end + 1)
    if end < 0 or line_end < 0:
        raise found_instead(path, "a header that does not end", _EXPECTED)
    order, inside, is_known = "", "", True  # the element that a line is of, and whether its size is needed
    elements: dict[str, tuple[int, list[tuple[str, str]]]] = {}
    told = head[:end].decode("ascii", "replace")
    for line in told.splitlines()[1:]:
        match line.split():
            case ["format", name, *_]:
                if name not in _ORDERS:
                    raise found_instead(path, f"the format {name}", _EXPECTED)
                order = _ORDERS[name]
            case ["element", name, count] if name not in elements and _COUNT.fullmatch(count):
                inside, is_known = name, "vertex" not in elements or (is_known and name in _TABLES)
                if is_known:
                    elements[name] = int(count), []
            case ["property", "list", *_] if is_known and inside:
                raise found_instead(path, "lists among or before its vertices", _EXPECTED)
            case ["property", kind, name] if is_known and inside:
                if kind not in _TYPES:
                    raise found_instead(path, f"numbers of the type {kind}", _EXPECTED)
                elements[inside][1].append((name, order + _TYPES[kind]))
            case ["property" | "comment" | "obj_info", *_] | []:
                pass
            case _:
                raise found_instead(path, f"the line {line!r} in its header", _EXPECTED)
    if not order or not all(elements.get("vertex", [None])):
        raise found_instead(path, "no Gaussians", _EXPECTED)
    try:
        return line_end + 1, {name: (count, np.dtype(fields)) for name, (count, fields) in elements.items()}, told
    except ValueError as error:  # a name twice
        raise found_instead(path, f"a header that cannot be ({error})", _EXPECTED) from error


def _unpacked(path: str | Path, vertex: Array, chunk: Array | None = None, sh: Array | None = None) -> Array:
    """The table that a compressed one of SuperSplat stands for: _SHARED Gaussians lie between two numbers of a chunk,
    in 32 bits for three or four numbers. FrogError for what is none."""
    group = np.arange(len(vertex)) // _SHARED
    ranges: Array = vertex if chunk is None or len(chunk) <= group[-1] else chunk[group]
    further: Array = np.empty(len(vertex), []) if sh is None else sh
    known = [name in (ranges.dtype.names or ()) for name in _RANGES]
    if not all(known[:12]) or any(known[12:]) != all(known[12:]) or len(further) != len(vertex):
        raise found_instead(path, "a compressed one without its ranges or harmonics", _EXPECTED)

    def between(first: int, shares: Array) -> Array:
        ends = (_RANGES[first : first + 3], _RANGES[first + 3 : first + 6])
        low, high = (np.stack([ranges[name] for name in names], axis=1).astype(np.float64) for names in ends)
        return np.asarray(low + (high - low) * shares)

    with np.errstate(all="ignore"):  # what is no number is left out afterwards
        places, turns, sizes, colors = (_shares(vertex[f"packed_{name}"], *bits) for name, bits in _PACKED.items())
        opacities, colors = colors[:, 3:], colors[:, :3]
        columns = [
            between(0, places),
            between(6, sizes),
            ((between(12, colors) if known[-1] else colors) - 0.5) / SH_DC,
            np.log(opacities) - np.log1p(-opacities),
            completed((turns[:, 1:] - 0.5) * math.sqrt(2), np.rint(3 * turns[:, 0]).astype(np.int64)),
        ]
        rest = [name for name in further.dtype.names or () if name.startswith("f_rest_")]
        for level in (further[name].astype(np.float64) for name in rest):
            columns.append((np.where((level == 0) | (level == 255), level / 255, (level + 0.5) / 256) - 0.5) * 8)
        names = [*"xyz", *_SIZES, *_COLORS, "opacity", *_TURNS, *rest]
        return np.rec.fromarrays(np.column_stack(columns).T, dtype=[(name, "<f4") for name in names])


def moves(path: Path) -> bool:
    """Whether a file's Gaussians move by themselves."""
    with path.open("rb") as file:
        return b" trbf_center" in file.read(LONGEST_HEADER)


def splats_of(path: str | Path, table: Array) -> StillSource:
    """The Gaussians of a table with the properties of a ``.ply``; FrogError for one that holds none."""
    names = set(table.dtype.names or ())
    rest = next(i for i in itertools.count() if f"f_rest_{i}" not in names)
    columns_of = {
        "means": [*"xyz"],
        "quaternions": _TURNS,
        "log_scales": _SIZES,
        "opacity_logits": ["opacity"],
        "sh": [*_COLORS, *(f"f_rest_{i}" for i in range(rest))],
    }
    if "trbf_center" in names:
        curve = [*(f"motion_{i}" for i in range(9)), *(f"omega_{i}" for i in range(4))]
        columns_of[CURVES] = [*curve, "trbf_center", "trbf_scale"]
    if "f_t_0" in names:
        full = "the full model of SpacetimeGaussians, whose colours a network in another file makes"
        raise found_instead(path, full, "its lite model")
    flat = {"scale_2": np.full(len(table), -np.inf)} if "scale_2" not in names and "scale_1" in names else {}
    if "f_dc_0" not in names and all(name in names and table.dtype[name] == np.uint8 for name in _RGB):
        flat |= {to: (table[name] / 255.0 - 0.5) / SH_DC for to, name in zip(_COLORS, _RGB, strict=True)}
    missing = [name for columns in columns_of.values() for name in columns if name not in names | set(flat)]
    if missing:
        raise found_instead(path, f"no {', '.join(missing)}", f"{_EXPECTED} with every property of a Gaussian")
    if rest not in _RESTS:
        raise found_instead(path, f"{rest} properties f_rest", "0, 9, 24 or 45 of them")
    with np.errstate(over="ignore", invalid="ignore"):  # what no float32 holds is no number then, and is left out
        world, places = _local_places(table)
        made = places | flat
        arrays = {
            name: np.stack([_floats(path, made[c] if c in made else table[c]) for c in columns], axis=1)
            for name, columns in columns_of.items()
        }
        if CURVES in arrays:
            _retime(arrays)
    arrays["opacity_logits"] = arrays["opacity_logits"][:, 0]
    halves = any(table.dtype[name].kind != "f" for columns in columns_of.values() for name in columns if name in names)
    arrays, left_out = _cleaned(path, arrays, halves=halves)
    colors = arrays["sh"]
    further = colors[:, 3:].reshape(len(colors), 3, -1).transpose(0, 2, 1)
    arrays["sh"] = np.ascontiguousarray(np.concatenate([colors[:, None, :3], further], axis=1))
    doubts = {
        _NO_LOGITS: arrays["opacity_logits"].min() >= 0 and arrays["opacity_logits"].max() <= 1,
        _NO_LOGARITHMS: arrays["log_scales"].min() >= 0,
    }
    notes = tuple(note for note, holds in doubts.items() if holds and len(table) > 1)
    if CURVES in arrays:
        return CurveSource(canonical_gaussians(arrays), left_out, "ply", arrays, world, (*notes, _NO_DURATION))
    return StillSource(canonical_gaussians(arrays), left_out, "ply", arrays, world, notes)


def _retime(arrays: SceneArrays) -> None:
    """Makes ours of SpacetimeGaussians' arrays, in place: the last frame is at time 1, quaternions will have length
    one, and colours are harmonics."""
    curves, length = arrays[CURVES], np.linalg.norm(arrays["quaternions"], axis=1, keepdims=True)
    share = 1 - 1 / CurveSource.frame_count
    curves[:, :13] *= share ** np.repeat([1, 2, 3, 1], [3, 3, 3, 4])
    curves[:, 9:13] /= np.where(length > 0, length, 1)
    curves[:, 13] /= share
    curves[:, 14] -= math.log(share)
    arrays["sh"][:, :3] = (arrays["sh"][:, :3] - 0.5) / SH_DC


def _local_places(table: Array) -> tuple[World, dict[str, Array]]:
    """A world whose origin lies among the Gaussians, and x, y and z in it, where single precision would move them by
    a part of their size; else the file's own world, and no places."""
    if any(table.dtype[name].kind != "f" or table.dtype[name].itemsize != 8 for name in "xyz"):
        return FILES_OWN, {}
    middle, size = [_median(table[name]) for name in "xyz"], _median(np.stack([table["scale_0"], table["scale_1"]]))
    farthest = max(map(abs, middle))
    if farthest * np.finfo(np.float32).eps < _COARSE * np.exp(size) or farthest > _MAX_ORIGIN:
        return FILES_OWN, {}
    x, y, z = (float(round(value)) for value in middle)
    return World((x, y, z)), {"x": table["x"] - x, "y": table["y"] - y, "z": table["z"] - z}


def _floats(path: str | Path, column: Array) -> Array:
    """(N,) float32 of a property: of floats, or of whole numbers of 16 bits, in which some programs write half floats
    because PLY has no name for them. FrogError for other whole numbers."""
    if column.dtype.kind != "f":
        if column.dtype.itemsize != 2:
            raise found_instead(path, f"whole numbers of {8 * column.dtype.itemsize} bits", f"floats, {_MEANING}")
        column = column.view(column.dtype.str.translate(str.maketrans("iu", "ff")))
    return column.astype(np.float32)


def _cleaned(path: str | Path, arrays: SceneArrays, *, halves: bool) -> tuple[SceneArrays, int]:
    """Arrays with unit quaternions and bounded logits, and how many rows are left out, whose numbers are not finite or
    too large to be drawn. FrogError if most of the table cannot be splats.

    Args:
        arrays: ``means`` (N, 3), ``quaternions`` (N, 4), ``log_scales`` (N, 3), ``opacity_logits`` (N,) and ``sh``
            (N, ...), float32; changed in place.
        halves: whether numbers were read as half floats from whole numbers.
    """
    logits, scales = arrays["opacity_logits"], arrays["log_scales"]
    scales[np.isneginf(scales)] = _THINNEST
    endless = np.isinf(logits)
    logits[endless] = np.copysign(_MOST_CERTAIN, logits[endless])
    fits = np.logical_and.reduce([bounded(array) for array in arrays.values()]) & (scales <= _LARGEST_SIZE).all(axis=1)
    if complaint := _complaint(arrays, fits):
        made = "whole numbers of 16 bits that are no half floats: " if halves else ""
        raise found_instead(path, made + complaint, _MEANING)
    kept = arrays if fits.all() else {name: array[fits] for name, array in arrays.items()}
    kept["opacity_logits"] = kept["opacity_logits"].clip(-_MOST_CERTAIN, _MOST_CERTAIN)
    kept["quaternions"] = units(kept["quaternions"])
    return kept, int((~fits).sum())


def _complaint(arrays: SceneArrays, fits: Array) -> str:
    """What shows that most rows are no splats; "" where nothing does."""
    size, logit = _median(arrays["log_scales"]), _median(np.abs(arrays["opacity_logits"]))
    if size > _USUAL_SIZE:
        return f"sizes of e to the {size:,.0f} for half of the Gaussians"
    if logit > 1000:
        return f"opacities with logits of {logit:,.0f} for half of the Gaussians"
    if fits.mean() < 0.5:
        return f"{(~fits).sum():,} of {len(fits):,} Gaussians with numbers that are not finite or too large"
    length = _median(np.linalg.norm(arrays["quaternions"][fits].astype(np.float64), axis=1))
    if length > 200 or (length == 0 and len(fits) > 1):
        return f"quaternions of length {length:,.0f} for half of the Gaussians"
    color = _median(np.abs(arrays["sh"][fits].reshape(fits.sum(), -1)[:, :3]))
    return f"colours of {color:,.0f} for half of the Gaussians" if color > 100 else ""


def _median(numbers: Array) -> float:
    """Of the finite ones; 0 where there are none."""
    finite = numbers[np.isfinite(numbers)].astype(np.float64)
    return float(np.median(finite)) if finite.size else 0.0
