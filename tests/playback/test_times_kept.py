"""A scene remembers the last times, its frames' memory is used again, and no caller ever sees another's numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.builders import ATTRIBUTES, scene_file
from support.played_scenes import in_four_threads

from frog_blender.engine.gaussians import NumpyGaussians
from frog_blender.engine.playback.frame_delta import BufferPool
from frog_blender.engine.playback.player import TIMES_KEPT, ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile


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


def test_a_static_scene_is_computed_once() -> None:
    scene = playable("static")
    assert scene.at(0.1).means is not None and scene.at(0.9).means is not None
    assert len(scene.computed) == 1


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
            np.testing.assert_array_equal(scene.at(time).means, expected[time]["means"])
        for time, part in held.items():
            np.testing.assert_array_equal(part, expected[time][name][3:7], err_msg=name)


def test_threads_see_what_one_alone_sees() -> None:
    scene = playable(deformed_sh=4)
    times = np.linspace(0, 1, 7)
    expected = {time: scene.at(time).sh.copy() for time in times}
    wrong: list[float] = []

    def play(seed: int) -> None:
        for time in np.random.default_rng(seed).choice(times, 60):
            gaussians = scene.at(time)
            if not np.array_equal(gaussians.sh, expected[time]):
                wrong.append(time)

    in_four_threads(play)
    assert not wrong


def test_memory_is_used_again_when_nobody_holds_it() -> None:
    constant = np.arange(12.0, dtype=np.float32).reshape(4, 3)
    memory = BufferPool({"a": np.zeros(5, np.float32), "b": constant})
    first = memory.take()
    assert {name: array.shape for name, array in first.items()} == {"a": (5,), "b": (4, 3)}
    np.testing.assert_array_equal(first["b"], constant)
    place = first["a"].ctypes.data
    part = first["b"][1:2, ::2]
    del first
    assert memory.take()["a"].ctypes.data != place  # a part of it is still held
    del part
    assert place in {frame["a"].ctypes.data for frame in [memory.take(), memory.take()]}
