"""Played scenes that tests share: what is the same bits, and scenes whose Gaussians come and go."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from support.builders import scene_file

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.frame_delta import column_of
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import WIDTHS, SceneFile

TIMES = (0.0, 0.31, 0.5, 1.0)


def assert_same_bits(scene: SceneFile, times: tuple[float, ...] = TIMES) -> ScenePlayer:
    """Joined parts and columns are what another player of the scene computes as a whole."""
    playable, other = ScenePlayer(scene), ScenePlayer(scene)
    parts = {time: playable.delta_at(time) for time in times}
    for time, part in parts.items():
        assert tuple(part) == playable.changing
        expected, found = other.at(time), playable.at(time, part)
        for name in ATTRIBUTES:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
        for name in playable.columns:
            column = playable.column(name, part)
            assert column.shape == (playable.count, WIDTHS[name]) and column.flags.c_contiguous
            np.testing.assert_array_equal(column, column_of(expected, name), err_msg=name)
    return playable


def in_four_threads(work: Callable[[int], None]) -> None:
    """``work(seed)`` in each at once, until all are done."""
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(work, range(4)))


def flickering(count: int = 300, **model: object) -> SceneFile:
    """Each Gaussian is transparent at most of its times."""
    scene = scene_file(count, modulation=True, **model)
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    arrays["network.output_weight"][10] *= 60
    arrays["network.output_bias"][10] = -4.0
    return SceneFile(scene.header, arrays)
