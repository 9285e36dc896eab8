"""What is kept for a time brings back the same bits in bounded memory."""

from dataclasses import replace

import numpy as np
import pytest
from support.builders import scene_file
from support.played_scenes import assert_same_bits, in_four_threads

from frog_blender.engine.gaussians import ATTRIBUTES, NumpyGaussians
from frog_blender.engine.playback.frame_delta import BufferPool, FrameCache, FrameDelta
from frog_blender.engine.playback.player import TIMES_KEPT, ScenePlayer
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
    assert playable.changing == () and playable.delta_at(0.4) == {} and playable.time_of(3.0) == 0.0


@pytest.mark.parametrize(
    ("rows", "name"), [((0, 3), "means"), ((3, 6), "scales"), ((6, 10), "quaternions"), ((10, 14), "base")]
)
def test_silent_heads_change_nothing(rows: tuple[int, int], name: str) -> None:
    playable = assert_same_bits(silenced(scene_file(150, moving=99), slice(*rows)))
    assert name not in playable.changing and len(playable.changing) == 3


def test_only_what_moves_takes_memory() -> None:
    few, all_of_them = (ScenePlayer(scene_file(150, moving=moving)).delta_bytes for moving in (15, 150))
    assert (few, all_of_them) == (15 * 14 * 4, 150 * 14 * 4)


def part(numbers: int) -> FrameDelta:
    return {"means": np.zeros((numbers, 3), np.float32)}


def test_the_cache_forgets_what_was_not_used_for_longest() -> None:
    cache = FrameCache(limit=5 * 12)
    for time in (0.0, 0.1, 0.2):
        cache.keep(("a", time), part(1))
    cache.keep(("b", 0.0), part(2))
    assert (cache.bytes, len(cache)) == (60, 4)
    assert cache.find(("a", 0.0)) is not None  # used again
    cache.keep(("b", 0.5), part(2))
    kept = [cache.find(key) is not None for key in (("a", 0.0), ("a", 0.1), ("a", 0.2), ("b", 0.0))]
    assert kept == [True, False, False, True]
    assert cache.bytes <= cache.limit
    cache.keep(("b", 0.5), part(1))
    assert cache.bytes == 12 + 24 + 12, "the same time again replaces the former entry"
    cache.keep(("c", 0.0), part(6))
    assert cache.find(("c", 0.0)) is None and cache.bytes == 48, "larger than everything allowed"
    cache.forget("b")
    assert (cache.bytes, len(cache)) == (12, 1)
    cache.set_limit(11)
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
    assert cache.bytes == sum(kept["means"].nbytes for kept in map(cache.find, keys) if kept is not None) <= 1000


class CountingPlayer(ScenePlayer):
    """Lists the times that it computes, as they come."""

    def __init__(self, scene: SceneFile) -> None:
        self.computed: list[float] = []
        super().__init__(scene)

    def compute(self, time: float) -> NumpyGaussians:
        self.computed.append(time)
        return super().compute(time)


def playable(method: str = "frog", **model: object) -> CountingPlayer:
    scene = scene_file(300, **({"fusion": "dual"} if method == "ed3dgs" else {}), **model)
    return CountingPlayer(SceneFile(replace(scene.header, method=method), scene.arrays))


def test_the_last_times_are_not_computed_again() -> None:
    scene = playable()
    computed = scene.computed
    times = [i / 10 for i in range(TIMES_KEPT)]
    first = {time: scene.at(time) for time in times}
    for time in times:
        again = scene.at(time)
        assert all(np.shares_memory(getattr(again, name), getattr(first[time], name)) for name in ATTRIBUTES)
    assert computed == times
    scene.at(times[0])  # used last, so the next new one pushes out the second
    scene.at(0.95)
    scene.at(times[0])
    assert computed == [*times, 0.95]
    scene.at(times[1])
    assert computed == [*times, 0.95, times[1]]
    still = playable("static")
    assert still.at(0.1).means is not None and still.at(0.9).means is not None
    assert still.computed == [0.0], "a static scene is computed once"


@pytest.mark.parametrize("method", ["frog", "ed3dgs", "static"])
def test_nobody_can_write_into_what_others_are_shown(method: str) -> None:
    scene = playable(method, deformed_sh=0)
    gaussians = scene.at(0.3)
    for name in ATTRIBUTES:
        array = getattr(gaussians, name)
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    gaussians.means = np.zeros((1, 3))  # the caller's own attribute
    assert len(scene.at(0.3).means) == 300


@pytest.mark.parametrize("deformed", [0, 1, 4])
def test_a_frame_that_is_held_keeps_its_numbers(deformed: int) -> None:
    """Whatever its holder kept of it, and however many frames come after."""
    scene = playable(deformed_sh=deformed)
    times = np.linspace(0, 1, 9)
    expected = {time: {name: getattr(scene.at(time), name).copy() for name in ATTRIBUTES} for time in times}
    for name in ATTRIBUTES:
        held = {time: getattr(scene.at(time), name)[3:7] for time in times}
        for time in [*times, *times[::-1]]:
            np.testing.assert_array_equal(getattr(scene.at(time), name), expected[time][name])
        for time, part in held.items():
            np.testing.assert_array_equal(part, expected[time][name][3:7], err_msg=name)


def test_threads_see_what_one_alone_sees() -> None:
    scene = playable(deformed_sh=4)
    times = np.linspace(0, 1, 7)
    expected = {time: scene.at(time).sh.copy() for time in times}

    def play(seed: int) -> None:
        for time in np.random.default_rng(seed).choice(times, 60):
            np.testing.assert_array_equal(scene.at(time).sh, expected[time])

    in_four_threads(play)


def test_memory_is_used_again_when_nobody_holds_it() -> None:
    constant = np.arange(12.0, dtype=np.float32).reshape(4, 3)
    memory = BufferPool({"a": np.zeros(5, np.float32), "b": constant})
    first, _ = memory.take()
    assert {name: array.shape for name, array in first.items()} == {"a": (5,), "b": (4, 3)}
    np.testing.assert_array_equal(first["b"], constant)
    place = first["a"].ctypes.data
    part = first["b"][1:2, ::2]
    del first
    assert memory.take()[1]["a"] != place  # a part of it is still held
    del part
    frames = [memory.take(), memory.take()]
    assert place in {addresses["a"] for _, addresses in frames}
