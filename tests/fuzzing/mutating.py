"""Damage and lies: what becomes of a ``.frog`` on a bad disk, and in the hands of somebody who means harm."""

from __future__ import annotations

import copy
import json
import random
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any

HOSTILE: list[Any] = [
    *(2**63, 2**31, 2**24, 65_537, -1, 0, 1, 10**18, 10**400, 1e308, 1e-308, float("nan"), float("inf"), -float("inf")),
    *(True, None, "", "x" * 2000, "../../etc/passwd", "\0", "\x1b[2J", "a\nb", "\ud800", "means", "lifetimes"),
    *([], {}, [[]], [2**40, 3], {"x": {"x": []}}, [0.0, 0.0, 0.0], ["frog"]),
]
NUMBERS = [float("nan"), float("inf"), -float("inf"), 3e38, -3e38, 1e-45, 0.0, 1e20, -1e20, 88.0, 1e9]

Mutation = Callable[[bytes, random.Random], bytes]


def flipped(content: bytes, chance: random.Random, end: int | None = None) -> bytes:
    changed = bytearray(content)
    for _ in range(chance.randint(1, 8)):
        changed[chance.randrange(end or len(changed))] = chance.randrange(256)
    return bytes(changed)


def in_the_header(content: bytes, chance: random.Random) -> bytes:
    return flipped(content, chance, 8 + _header_size(content))


def cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def torn(content: bytes, chance: random.Random) -> bytes:
    """A run of bytes taken out, doubled or replaced."""
    start = chance.randrange(len(content))
    end = min(len(content), start + chance.randint(1, 400))
    middle = chance.choice([b"", content[start:end] * 2, chance.randbytes(chance.randint(1, 400))])
    return content[:start] + middle + content[end:]


def lying(content: bytes, chance: random.Random) -> bytes:
    """A well-formed file whose header says something else somewhere."""
    header, texts, payload = _opened(content)
    for _ in range(chance.randint(1, 3)):
        change(chance.choice([header, *texts.values(), *texts.values()]), chance)
    return _closed(header, texts, payload)


def lying_about_the_scene(content: bytes, chance: random.Random) -> bytes:
    """One value of the scene's own header is another: most of the file is as it should be."""
    header, texts, payload = _opened(content)
    scene = texts[_own(texts)]
    change(scene if chance.random() < 0.5 else {"one": scene[chance.choice(list(scene))]}, chance)
    return _closed(header, texts, payload)


def said_twice(content: bytes, chance: random.Random) -> bytes:
    """A key of the scene's header stands there twice, with different values."""
    header, texts, payload = _opened(content)
    own = _own(texts)
    key, value, said = chance.choice(list(texts[own])), chance.choice(HOSTILE), json.dumps(texts[own])
    doubled = f"{{{json.dumps(key)}: {json.dumps(value)}, {said[1:]}"
    if chance.random() < 0.5:
        doubled = f"{said[:-1]}, {json.dumps(key)}: {json.dumps(value)}}}"
    header["__metadata__"][own] = doubled
    return _written(header, payload)


def odd_numbers(content: bytes, chance: random.Random) -> bytes:
    """Some of the arrays' numbers are none, or too large for anything."""
    header, texts, payload = _opened(content)
    changed = bytearray(payload)
    for _ in range(chance.choice([1, 5, 200])):
        struct.pack_into("<f", changed, 4 * chance.randrange(len(changed) // 4), chance.choice(NUMBERS))
    return _closed(header, texts, bytes(changed))


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


MUTATIONS: list[Mutation] = [
    *(flipped, in_the_header, cut, torn, lying, said_twice, odd_numbers, odd_packed_bytes),
    *[lying_about_the_scene] * 4,
]


def mutated(whole: list[bytes], seed: int, number: int) -> tuple[str, bytes]:
    """Mutation ``number`` of a seed, which is the same wherever it is made: what was done, and the file."""
    chance = random.Random(f"{seed}/{number}")
    mutation = chance.choice(MUTATIONS)
    return mutation.__name__, mutation(chance.choice(whole), chance)


def _own(texts: dict[str, Any]) -> str:
    """The name of a file's own header: a scene's, or a checkpoint's."""
    return next(name for name in ("frog", "frog-checkpoint") if name in texts)


def _header_size(content: bytes) -> int:
    return struct.unpack("<Q", content[:8])[0]


def _opened(content: bytes) -> tuple[dict[str, Any], dict[str, Any], bytes]:
    """The header, what of its metadata is JSON, and the arrays' bytes."""
    size = _header_size(content)
    header = json.loads(content[8 : 8 + size])
    texts = {}
    for name, text in header["__metadata__"].items():
        with suppress(ValueError):  # a bake's are no JSON
            texts[name] = json.loads(text)
    return header, texts, content[8 + size :]


def _closed(header: dict[str, Any], texts: dict[str, Any], payload: bytes) -> bytes:
    if isinstance(header.get("__metadata__"), dict):
        header["__metadata__"] |= {name: json.dumps(value) for name, value in texts.items()}
    return _written(header, payload)


def _written(header: dict[str, Any], payload: bytes) -> bytes:
    written = json.dumps(header).encode()
    return struct.pack("<Q", len(written)) + written + payload
