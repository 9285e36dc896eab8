"""Opens damaged and hostile ``.frog`` files; run by test_mutations.py in a process of its own.

    python mutating.py FOLDER COUNT SEED

Prints a JSON object: how many were refused in a sentence, how many played, and the peak of memory in bytes above what
opening undamaged files needs. Ends badly at the first other error, crash, or file that takes longer than 20 seconds.
"""

from __future__ import annotations

import copy
import json
import random
import resource
import signal
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from helpers import scene_file
from playing import spared

from frog_blender.engine.errors import FrogError
from frog_blender.engine.files import SceneFile, scene_bytes
from frog_blender.engine.inference.scene import PlayableScene

HOSTILE: list[Any] = [
    *(2**63, 2**31, -1, 0, 1, 1e308, float("nan"), float("inf"), True, None),
    *("", "x" * 2000, "../../etc/passwd", "\0", "means", [], {}, [[]], [2**40, 3], {"x": {"x": []}}),
]


def flipped(content: bytes, chance: random.Random, end: int | None = None) -> bytes:
    changed = bytearray(content)
    for _ in range(chance.randint(1, 8)):
        changed[chance.randrange(end or len(changed))] = chance.randrange(256)
    return bytes(changed)


def in_the_header(content: bytes, chance: random.Random) -> bytes:
    return flipped(content, chance, 8 + struct.unpack("<Q", content[:8])[0])


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
    size = struct.unpack("<Q", content[:8])[0]
    header = json.loads(content[8 : 8 + size])
    texts = {name: json.loads(text) for name, text in header["__metadata__"].items() if text[:1] in "{["}
    for _ in range(chance.randint(1, 3)):
        change(chance.choice([header, *texts.values(), *texts.values()]), chance)
    if isinstance(header.get("__metadata__"), dict):
        header["__metadata__"] |= {name: json.dumps(value) for name, value in texts.items()}
    written = json.dumps(header).encode()
    return struct.pack("<Q", len(written)) + written + content[8 + size :]


def change(node: Any, chance: random.Random) -> None:
    """Somewhere below ``node``, a value is replaced, doubled, taken out or made hostile."""
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return
        key = chance.choice(keys)
        if isinstance(node[key], dict | list) and chance.random() < 0.8:
            node = node[key]
            continue
        if chance.random() < 0.15:
            del node[key]
        elif isinstance(node[key], int | float) and chance.random() < 0.5:
            node[key] = node[key] * chance.choice([-1, 2, 0.5, 1e6]) + chance.choice([0, 1, -1])
        else:
            node[key] = copy.deepcopy(chance.choice(HOSTILE))
        return


MUTATIONS: list[Callable[[bytes, random.Random], bytes]] = [flipped, in_the_header, cut, torn, lying, lying]


def play(path: Path) -> bool:
    """True if the file was played, False if it was refused in one sentence."""
    try:
        scene = PlayableScene.load(path)
        scene.at(0.3), scene.part_at(0.7)
    except FrogError as error:
        sentence = str(error)
        assert "\n" not in sentence and len(sentence) < 1000, sentence
        return False
    return True


def main() -> None:
    folder, count, chance = Path(sys.argv[1]), int(sys.argv[2]), random.Random(int(sys.argv[3]))
    scenes = [scene_file(), scene_file(moving=13), scene_file(head_width=8), scene_file(modulation=True, fusion="dual")]
    mask = {"lifetimes": np.full((6, 1), 0b10100000, np.uint8)}  # the second of three groups is never seen
    scenes += [SceneFile(scenes[0].header, scenes[0].arrays | mask), spared()]
    whole = [scene_bytes(scene, compact=compact) for scene in scenes for compact in (False, True)]
    path = folder / "x.frog"
    for content in whole:
        path.write_bytes(content)
        assert play(path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    played = 0
    for number in range(count):
        mutation = chance.choice(MUTATIONS)
        content = mutation(chance.choice(whole), chance)
        path.write_bytes(content)
        signal.alarm(20)  # a file that hangs ends the process
        try:
            played += play(path)
        except BaseException:
            (folder / "culprit.frog").write_bytes(content)
            print(f"file {number}, {mutation.__name__}", file=sys.stderr)
            raise
    signal.alarm(0)
    unit = 1 if sys.platform == "darwin" else 1024
    peak = unit * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    print(json.dumps({"refused": count - played, "played": played, "peak": peak}))


if __name__ == "__main__":
    main()
