"""What of each Gaussian changes, as a file says it, and as it is put into one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.dynamics import (
    ALL_CHANGES,
    KEEPS_SHAPE,
    ONLY_FADES,
    STATIC,
    dynamics_of,
    kind_bounds,
)
from frog_blender.engine.scene.scene_file import OPACITY_TRACKS, SceneFile
from frog_blender.engine.training.compression.finalize import with_dynamics


def test_a_scene_of_one_kind() -> None:
    assert (dynamics_of(scene_file(5)) == ALL_CHANGES).all() and kind_bounds(dynamics_of(scene_file(5))) == []
    still = scene_file(5)
    arrays = {name: array for name, array in still.arrays.items() if name != "embeddings"}
    assert (dynamics_of(SceneFile(still.header, arrays)) == STATIC).all()
    some = dynamics_of(scene_file(5, moving=2))
    assert some.tolist() == [ALL_CHANGES, ALL_CHANGES, STATIC, STATIC, STATIC] and kind_bounds(some) == [2]


@pytest.mark.parametrize("fading", [[], [0, 6], [3]])
def test_what_is_asked_for_is_what_the_file_says(fading: list[int]) -> None:
    scene = scene_file(10, moving=8)
    flags = dynamics_of(scene)
    flags[[1, 4]], flags[fading] = KEEPS_SHAPE, ONLY_FADES
    arrays = dict(scene.arrays)
    if fading:
        arrays[OPACITY_TRACKS] = np.array(fading, np.uint8)[:, None].repeat(scene.header.frame_count, axis=1)
    found = with_dynamics(SceneFile(scene.header, arrays), flags)
    assert dynamics_of(found).tolist() == sorted(flags.tolist(), reverse=True)
    shaped = [k for k in range(8) if k not in (1, 4, *fading)]
    order = [*shaped, 1, 4, *fading, 8, 9]
    np.testing.assert_array_equal(found.arrays["means"], scene.arrays["means"][order])
    np.testing.assert_array_equal(found.arrays["embeddings"], scene.arrays["embeddings"][[*shaped, 1, 4]])
    before, after = ScenePlayer(scene).at(0.3), ScenePlayer(found).at(0.3)
    np.testing.assert_allclose(after.means[: len(shaped) + 2], before.means[[*shaped, 1, 4]], atol=1e-6)
    np.testing.assert_allclose(after.scales[: len(shaped)], before.scales[shaped], rtol=1e-5)
    np.testing.assert_allclose(after.scales[len(shaped) :][:2], np.exp(scene.arrays["log_scales"][[1, 4]]), rtol=1e-5)


def test_without_less_to_change_the_scene_stays() -> None:
    scene = scene_file(10, moving=8)
    found = with_dynamics(scene, dynamics_of(scene))
    assert found.header == replace(scene.header)
    for name, array in scene.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)
