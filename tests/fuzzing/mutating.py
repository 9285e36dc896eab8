"""Damage and lies: what becomes of a file on a bad disk, and in the hands of somebody who means harm."""

import copy
import io
import json
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

HOSTILE: list[Any] = [
    *(2**63, 2**31, 2**24, 65_537, -1, 0, 1, 10**18, 10**400, 1e308, 1e-308, float("nan"), float("inf"), -float("inf")),
    *(True, None, "", "x" * 2000, "../../etc/passwd", "\0", "\x1b[2J", "a\nb", "\ud800", "means"),
    *([], {}, [[]], [2**40, 3], {"x": {"x": []}}, [0.0, 0.0, 0.0], ["frog"]),
]
_NUMBERS = [
    *(0.0, -0.0, np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45),
    *(1.0, -1.0, 88.0, 1e9, 1e20, 2.0**31, -(2.0**63), 1e300),
]
_COUNTS = [0, 1, 0xFF, 0xFFFF, 2**31, 0x7FFFFFFF, 0xFFFFFFFF, 2**40, 2**63 - 1, 2**63, 2**64 - 1]
_WORDS = [
    *b"0 -1 1 3 255 65536 2147483648 99999999999 1e308 1e999 1e-320 nan inf -inf null true [] {} [[]]".split(),
    *b'" "" ../../x /etc/passwd data:, http://127.0.0.1:9/x double list half x'.split(),
    *(b"", b"\0", b"\n", b"\xff\xfe", b"1" * 400, b"[" * 3000),
]
_NPY_HEADERS = [
    *("(4, -3)", "(2**80, 3)", "()", "(3,)", "(10**9, 17)", "(1000000000, 17)", "(0, 17)", "'", "\n", "[", "(" * 50),
    *("'|O'", "'<U9'", "'<f2'", "'|u1'", "'<c8'", "'<f16'", "'|b1'", "'<M8[s]'", "'a'", "True", "None", "0x", "{}"),
]
_KINDS = {"F32": "<f4", "F64": "<f8", "I64": "<i8", "U8": "u1", "F16": "<f2", "I32": "<i4"}
_WORD = re.compile(rb"[-+.A-Za-z0-9_:]+")

Mutation = Callable[[bytes, random.Random], bytes]


def flipped(content: bytes, chance: random.Random, end: int | None = None) -> bytes:
    changed = bytearray(content)
    for _ in range(chance.randint(1, 8)):
        changed[chance.randrange(end or len(changed))] = chance.randrange(256)
    return bytes(changed)


def at_the_start(content: bytes, chance: random.Random) -> bytes:
    """Bytes of what describes the rest."""
    return flipped(content, chance, min(chance.choice([128, 2000]), len(content)))


def cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def torn(content: bytes, chance: random.Random) -> bytes:
    """A run of bytes taken out, doubled or replaced."""
    start = chance.randrange(len(content))
    end = min(len(content), start + chance.randint(1, 400))
    middle = chance.choice([b"", content[start:end] * 2, chance.randbytes(chance.randint(1, 400))])
    return content[:start] + middle + content[end:]


def counts(content: bytes, chance: random.Random) -> bytes:
    """Some bytes, near the beginning or anywhere, are a hostile count or number."""
    changed = bytearray(content)
    end = min(len(changed), chance.choice([8, 64, 256, len(changed)]))
    for _ in range(chance.choice([1, 1, 3, 100])):
        size = chance.choice([2, 4, 4, 8])
        new = (chance.choice(_COUNTS) & (2 ** (8 * size) - 1)).to_bytes(size, "little")
        if size > 2 and chance.random() < 0.5:
            with np.errstate(all="ignore"):
                new = np.array(chance.choice(_NUMBERS)).astype(f"<f{size}").tobytes()
        start = chance.randrange(end)
        changed[start : start + size] = new
    return bytes(changed[: len(content)])


def words(content: bytes, chance: random.Random) -> bytes:
    """Some words and numbers of a text, or of a text before numbers, are hostile ones or others of the text."""
    for _ in range(chance.choice([1, 1, 2, 5])):
        matches = list(_WORD.finditer(content, 0, min(len(content), chance.choice([1000, 10_000, 10**9]))))
        if not matches:
            return content
        word = chance.choice(matches)
        other = chance.choice(_WORDS) if chance.random() < 0.7 else chance.choice(matches).group()
        content = content[: word.start()] + other + content[word.end() :]
    return content


def lines(content: bytes, chance: random.Random) -> bytes:
    """Lines change places, are doubled, taken out or very long."""
    parts = content.split(b"\n")
    index, other = chance.randrange(len(parts)), chance.randrange(len(parts))
    match chance.randrange(5):
        case 0:
            parts[index], parts[other] = parts[other], parts[index]
        case 1:
            parts.insert(other, parts[index])
        case 2:
            del parts[index]
        case 3:
            parts[index] = parts[index] + chance.choice([b"[", b"{", b"a.", b"-", b" ", b"\t", b"9"]) * 20_000
        case 4:
            parts = parts[:index] + parts[other:]
    return b"\n".join(parts)


def json_values(content: bytes, chance: random.Random) -> bytes:
    """Sound JSON whose values are others."""
    data = json.loads(content)
    for _ in range(chance.randint(1, 2)):
        if isinstance(data, dict | list) and data:
            with suppress(OverflowError):  # of a number that is hostile already
                change(data, chance)
    if chance.random() < 0.05:
        data = chance.choice(HOSTILE)
    return json.dumps(data).encode("utf-8", "surrogatepass")


def change(node: Any, chance: random.Random) -> None:
    """Somewhere below ``node``, a value is replaced, changed places with another, taken out or made hostile."""
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return
        key = chance.choice(keys)
        if isinstance(node[key], dict | list) and chance.random() < 0.8:
            node = node[key]
            continue
        how = chance.random()
        if how < 0.15:
            del node[key]
        elif how < 0.25:
            other = chance.choice(keys)
            node[key], node[other] = node[other], node[key]
        elif isinstance(node[key], int | float) and how < 0.6:
            node[key] = node[key] * chance.choice([-1, 2, 0.5, 3, 1e6]) + chance.choice([0, 1, -1])
        else:
            node[key] = copy.deepcopy(chance.choice(HOSTILE))
        return


def lying_npy(content: bytes, chance: random.Random) -> bytes:
    """A ``.npy`` whose header says something else."""
    end = 10 + struct.unpack("<H", content[8:10])[0]
    parts = content[10:end].decode().split(" ")
    for _ in range(chance.randint(1, 2)):
        parts[chance.randrange(min(len(parts), 8))] = chance.choice(_NPY_HEADERS)
    text = " ".join(parts).encode("latin1")
    version = bytes([chance.choice([1, 1, 1, 2, 3, 9]), 0])
    return content[:6] + version + struct.pack("<H", len(text)) + text + content[end:]


def numbers_of_npy(content: bytes, chance: random.Random) -> bytes:
    """A ``.npy`` with some hostile numbers."""
    array = np.load(io.BytesIO(content), allow_pickle=False).copy()
    with np.errstate(all="ignore"):
        for _ in range(chance.randint(1, 4)):
            array.flat[chance.randrange(array.size)] = np.array(chance.choice(_NUMBERS)).astype(array.dtype)
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def repacked(content: bytes, chance: random.Random) -> bytes:
    """A sound archive of unsound members."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(list(members))
    arrays = [lying_npy] if name.endswith(".npy") else [counts]
    members[name] = chance.choice([flipped, at_the_start, cut, torn, *arrays])(members[name], chance)
    if name.endswith(".npy") and chance.random() < 0.2:
        members[chance.choice(["other.npy", "../up.npy", "cam00", "points.npy", "\udcff.npy"])] = members.pop(name)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", chance.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as archive:
        for member, values in members.items():
            archive.writestr(member.encode("utf-8", "replace").decode(), values)
    return file.getvalue()


def in_the_header(content: bytes, chance: random.Random) -> bytes:
    return flipped(content, chance, 8 + _header_size(content))


def lying(content: bytes, chance: random.Random) -> bytes:
    """A well-formed file of safetensors whose header says something else somewhere."""
    header, texts, payload = _opened(content)
    for _ in range(chance.randint(1, 3)):
        change(chance.choice([header, *texts.values(), *texts.values()]), chance)
    return _closed(header, texts, payload)


def lying_about_the_scene(content: bytes, chance: random.Random) -> bytes:
    """One value of the scene's own header is another: most of the file is as it should be."""
    header, texts, payload = _opened(content)
    scene = texts.get("frog") or texts.get("frog-checkpoint")
    if scene is None:
        return lying(content, chance)
    change(scene if chance.random() < 0.5 else {"one": scene[chance.choice(list(scene))]}, chance)
    return _closed(header, texts, payload)


def odd_numbers(content: bytes, chance: random.Random) -> bytes:
    """Some of the arrays' numbers are hostile ones of their type."""
    header, texts, payload = _opened(content)
    changed = bytearray(payload)
    for _ in range(chance.randint(1, 3)):
        entry = header[chance.choice([name for name in header if name != "__metadata__"])]
        begin, end = entry["data_offsets"]
        with np.errstate(all="ignore"):
            number = np.array(chance.choice(_NUMBERS)).astype(_KINDS[entry["dtype"]]).tobytes()
        if places := range(begin, end, len(number)):
            for place in places if chance.random() < 0.2 else chance.choices(places, k=chance.choice([1, 1, 5, 200])):
                changed[place : place + len(number)] = number
    return _closed(header, texts, bytes(changed[: len(payload)]))


def odd_packed_bytes(content: bytes, chance: random.Random) -> bytes:
    """What a packed array's bytes come to is another, and as many: a lossless file has odd numbers instead."""
    header, texts, payload = _opened(content)
    if "packing" not in texts:
        return odd_numbers(content, chance)
    chosen, pieces, end = chance.choice(list(texts["packing"])), [], 0
    places = sorted((entry["data_offsets"], name) for name, entry in header.items() if name != "__metadata__")
    for (begin, after), name in places:
        piece = payload[begin:after]
        if name == chosen:
            stored = bytearray(zlib.decompress(piece))
            for _ in range(chance.choice([1, 20]) if stored else 0):
                struct.pack_into("<B", stored, chance.randrange(len(stored)), chance.choice([0, 127, 128, 255]))
            piece = zlib.compress(bytes(stored))
        header[name]["data_offsets"], header[name]["shape"] = [end, end + len(piece)], [len(piece)]
        end += len(piece)
        pieces.append(piece)
    return _closed(header, texts, b"".join(pieces))


TENSORS: list[Mutation] = [
    *(flipped, in_the_header, cut, torn, lying, odd_numbers, odd_packed_bytes),
    *[lying_about_the_scene] * 4,
]
"""What is done to a ``.frog`` or a checkpoint."""
_ANY: list[Mutation] = [flipped, flipped, cut, torn]
_BINARY: list[Mutation] = [*_ANY, at_the_start, *[counts] * 4]
_TEXT: list[Mutation] = [*_ANY, at_the_start, lines, lines, *[words] * 6]
_JSON: list[Mutation] = [*_ANY, *[json_values] * 4]
_ARCHIVE: list[Mutation] = [*_ANY, *[repacked] * 4]
_BY_ENDING: dict[str, list[Mutation]] = {
    **dict.fromkeys((".frog", ".checkpoint"), TENSORS),
    **dict.fromkeys((".txt", ".yml", ".toml", ".usda", ".gltf"), _TEXT),
    **dict.fromkeys((".json", ""), _JSON),
    **dict.fromkeys((".npz", ".zip", ".sog"), _ARCHIVE),
    ".npy": [*_ANY, at_the_start, at_the_start, lying_npy, lying_npy, numbers_of_npy],
    ".ply": [*_BINARY, *[words] * 6],
}


def mutations_of(path: Path) -> list[Mutation]:
    """What is done to a file, by the end of its name."""
    return _BY_ENDING.get(path.suffix, _BINARY)


def _header_size(content: bytes) -> int:
    return struct.unpack("<Q", content[:8])[0]


def _opened(content: bytes) -> tuple[dict[str, Any], dict[str, Any], bytes]:
    """The header, its metadata's JSON, and the arrays' bytes."""
    size = _header_size(content)
    header = json.loads(content[8 : 8 + size])
    texts = {name: json.loads(text) for name, text in header["__metadata__"].items()}
    return header, texts, content[8 + size :]


def _closed(header: dict[str, Any], texts: dict[str, Any], payload: bytes) -> bytes:
    if isinstance(header.get("__metadata__"), dict):
        header["__metadata__"] |= {name: json.dumps(value) for name, value in texts.items()}
    written = json.dumps(header).encode()
    return struct.pack("<Q", len(written)) + written + payload
