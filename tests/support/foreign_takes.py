"""Scenes that are given to other programs, and what has to come back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.builders import scene_file

from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import write_scene

HALF = 2.0**-11
"""Of a number: by so much a half float may differ from it."""


def partly_static(folder: Path, **settings: object) -> ScenePlayer:
    """Forty Gaussians over seven frames; the first 25 move, turn, grow, fade and tint."""
    write_scene(folder / "x.frog", scene_file(moving=25, **settings))
    return ScenePlayer.load(folder / "x.frog")


def sorted_like(found: GaussianArrays, expected: GaussianArrays, places: GaussianArrays) -> GaussianArrays:
    """``found`` in the order of ``expected``. Both are of one time, ``places`` of another whose means tell them apart.

    Imports put Gaussians that move first: an order that is the same at all times.
    """
    distances = np.linalg.norm(places.means[None] - expected.means[:, None], axis=2)
    order = distances.argmin(axis=1)
    assert sorted(order) == list(range(len(order)))
    return found.part(order)


def assert_equal_within(
    found: GaussianArrays, expected: GaussianArrays, relative: float, absolute: float = 1e-6
) -> None:
    """All numbers within a tolerance; turns by either sign of their quaternions."""
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=relative, atol=absolute, err_msg=name
        )
    signs = np.sign((found.quaternions * expected.quaternions).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(found.quaternions * signs, expected.quaternions, atol=2 * relative + absolute)


def assert_plays_alike(
    found: ScenePlayer,
    expected: Callable[[float], GaussianArrays],
    frames: list[float],
    relative: float,
    absolute: float = 1e-6,
) -> None:
    """An imported scene at some frames, in whatever order it holds the Gaussians, against what was exported."""
    first, start = found.at_frame(0), expected(0)
    for frame in frames:
        assert_equal_within(sorted_like(found.at_frame(frame), start, first), expected(frame), relative, absolute)
