"""What is cached for a time brings back the same bits, in bounded memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.builders import scene_file
from support.played_scenes import assert_same_bits, in_four_threads

from frog_blender.engine.playback.frame_delta import FrameCache, FrameDelta
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile

MODELS = [
    {},
    {"moving": 17},
    {"moving": 1},
    {"moving": 131, "deformed_sh": 0},
    {"moving": 131, "deformed_sh": 4, "sh_count": 9},
    {"deformed_sh": 3, "head_width": 8},
    {"fusion": "dual", "moving": 100},
    {"modulation": True, "moving": 100, "opacity_reduction": "paper"},
]


def silenced(scene: SceneFile, rows: slice) -> SceneFile:
    """The same with a head that gives zero, as training leaves it."""
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    arrays["network.output_weight"][rows] = 0
    arrays["network.output_bias"][rows] = 0
    return SceneFile(scene.header, arrays)


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_what_is_kept_brings_back_the_same_bits(model: dict) -> None:
    playable = assert_same_bits(scene_file(150, **model))
    assert {"means", "scales", "quaternions", "base"} <= set(playable.changing) <= set(playable.columns)


def test_a_static_scene_keeps_nothing() -> None:
    scene = scene_file(20)
    playable = assert_same_bits(SceneFile(replace(scene.header, method="static", model={}), scene.arrays))
    assert playable.changing == () and playable.delta_at(0.4).bytes == 0 and playable.time_of(3.0) == 0.0


@pytest.mark.parametrize(
    ("rows", "name"), [((0, 3), "means"), ((3, 6), "scales"), ((6, 10), "quaternions"), ((10, 14), "base")]
)
def test_silent_heads_change_nothing(rows: tuple[int, int], name: str) -> None:
    playable = assert_same_bits(silenced(scene_file(150, moving=99), slice(*rows)))
    assert name not in playable.changing and len(playable.changing) == 3


def test_only_what_moves_takes_memory() -> None:
    few, all_of_them = (ScenePlayer(scene_file(150, moving=moving)).delta_at(0.5).bytes for moving in (15, 150))
    assert (few, all_of_them) == (15 * 14 * 4, 150 * 14 * 4)


def part(numbers: int) -> FrameDelta:
    return FrameDelta({"means": np.zeros((numbers, 3), np.float32)})


def test_the_cache_forgets_what_was_not_used_for_longest() -> None:
    cache = FrameCache(limit=5 * 12)
    for time in (0.0, 0.1, 0.2):
        cache.keep(("a", time), part(1))
    cache.keep(("b", 0.0), part(2))
    assert (cache.bytes, len(cache)) == (60, 4)
    assert cache.find(("a", 0.0)) is not None  # used again
    cache.keep(("b", 0.5), part(2))
    assert [key in cache for key in (("a", 0.0), ("a", 0.1), ("a", 0.2), ("b", 0.0))] == [True, False, False, True]
    assert cache.bytes <= cache.limit
    cache.keep(("b", 0.5), part(1))
    assert cache.bytes == 12 + 24 + 12, "the same time again replaces the former entry"
    cache.keep(("c", 0.0), part(6))
    assert ("c", 0.0) not in cache and cache.bytes == 48, "larger than everything allowed"
    cache.forget("b")
    assert (cache.bytes, len(cache)) == (12, 1)
    cache.limit = 11
    assert (cache.bytes, len(cache), cache.find(("a", 0.0))) == (0, 0, None)


def test_the_cache_of_many_threads_adds_up() -> None:
    cache = FrameCache(limit=1000)

    keys = [(str(token), float(time)) for token in range(3) for time in range(9)]

    def work(seed: int) -> None:
        random = np.random.default_rng(seed)
        for _ in range(400):
            key = keys[random.integers(len(keys))]
            if cache.find(key) is None:
                cache.keep(key, part(int(random.integers(1, 20))))
            if random.random() < 0.02:
                cache.forget(key[0])

    in_four_threads(work)
    assert cache.bytes == sum(found.bytes for found in map(cache.find, keys) if found is not None) <= 1000
