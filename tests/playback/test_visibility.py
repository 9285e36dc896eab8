"""What cannot be seen is not deformed, and no image tells the difference."""

from __future__ import annotations

import numpy as np
import pytest
from support.builders import scene_file
from support.deformation_fields import field_arrays, in_groups, output_arrays

from frog_blender.engine.errors import FrogError
from frog_blender.engine.native.deformation import FieldShape, PlaybackField, deform
from frog_blender.engine.playback.groups import (
    GROUP_SIZE,
    VisibilityMask,
    mean_deformed_share,
    pack_group_bits,
    sort_by_visibility,
    visible_intervals,
)
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile


def test_lifetimes_tell_between_which_frames_gaussians_show() -> None:
    def opacities(time: float) -> np.ndarray:
        frame = 4 * time
        return np.array([0.5, 0.0, 0.5 * (frame <= 1), 0.5 * (2.2 < frame < 2.4), 0.003 * (frame == 3)], np.float32)

    expected = [[1, 0, 1, 0, 0], [1, 0, 1, 0, 0], [1, 0, 0, 1, 0], [1, 0, 0, 0, 0]]
    np.testing.assert_array_equal(visible_intervals(opacities, 5), np.array(expected, bool))


def test_those_of_the_same_times_lie_together() -> None:
    random = np.random.default_rng(0)
    kinds = random.random((9, 6)) < 0.4
    lives = kinds[:, random.integers(6, size=40 * GROUP_SIZE)]
    order = sort_by_visibility(lives)
    assert sorted(order) == list(range(40 * GROUP_SIZE))
    shares = [mean_deformed_share(pack_group_bits(each), 40 * GROUP_SIZE) for each in (lives, lives[:, order])]
    assert shares[0] > 0.9 and lives.mean() <= shares[1] < lives.mean() + 5 / 40


@pytest.mark.parametrize("count", [1, GROUP_SIZE, 9 * GROUP_SIZE + 3])
def test_bits_come_back_at_a_time(count: int) -> None:
    lives = np.random.default_rng(count).random((6, count)) < 0.05
    bits = pack_group_bits(lives)
    assert bits.dtype == np.uint8 and bits.shape == (6, -(-count // GROUP_SIZE // 8))
    groups = VisibilityMask(bits, count)
    for time, interval in ((0.0, 0), (0.1, 0), (0.51, 3), (0.99, 5), (1.0, 5)):
        expected = [lives[interval, g : g + GROUP_SIZE].any() for g in range(0, count, GROUP_SIZE)]
        np.testing.assert_array_equal(groups.at(time), np.array(expected, np.uint8))


@pytest.mark.parametrize(
    "bits", [np.zeros((6, 2), np.uint8), np.zeros((0, 1), np.uint8), np.zeros(6, np.uint8), np.zeros((6, 1), "f")]
)
def test_bits_of_another_scene_are_refused(bits: np.ndarray) -> None:
    with pytest.raises(ValueError, match="lifetimes"):
        VisibilityMask(bits, 100)
    scene = scene_file(100)
    with pytest.raises(FrogError, match="lifetimes of 7 groups"):
        ScenePlayer(SceneFile(scene.header, scene.arrays | {"lifetimes": bits}))


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("count", [5, 7 * GROUP_SIZE, 200])
def test_unseen_groups_are_as_canonical_but_transparent(count: int, kept: bool) -> None:
    shape = FieldShape(0, 4, 1, "unit", 10.0, 1.0, 0.5)
    arrays = field_arrays(shape, 20, 5, count, sh_count=4)
    field = PlaybackField(shape, in_groups(shape, arrays, kept), kept)
    whole, still = output_arrays(shape, count), output_arrays(shape, count)
    field.deform({}, whole)
    deform(shape, arrays | {"embeddings": arrays["embeddings"][:0]}, still)
    lengths = np.linalg.norm(still["quaternions"], axis=1, keepdims=True)
    still["quaternions"] /= np.maximum(lengths, 1e-12)
    still["opacities"][:] = 0
    groups = -(-count // GROUP_SIZE)
    masks = [np.arange(groups) % 3 == k for k in (0, 1)] + [np.zeros(groups, bool), np.ones(groups, bool)]
    again = output_arrays(shape, count) | {"was_visible": np.ones(groups, np.float32)}
    for mask in masks:
        fresh = output_arrays(shape, count)
        field.deform({}, fresh, mask.astype(np.uint8))
        field.deform({}, again, mask.astype(np.uint8))
        seen = np.repeat(mask, GROUP_SIZE)[:count]
        np.testing.assert_array_equal(again["was_visible"] != 0, mask)
        for name in ("means", "quaternions", "scales", "opacities"):
            np.testing.assert_array_equal(fresh[name], again[name], err_msg=name)
            np.testing.assert_array_equal(fresh[name][seen], whole[name][seen], err_msg=name)
            np.testing.assert_allclose(fresh[name][~seen], still[name][~seen], rtol=1e-6, atol=1e-6, err_msg=name)


def test_what_was_left_alone_before_is_not_written_again() -> None:
    shape = FieldShape(0, 4, 1, "unit", 10.0, 1.0, 0.5)
    arrays = field_arrays(shape, 20, 5, 3 * GROUP_SIZE, sh_count=4)
    result = output_arrays(shape, 3 * GROUP_SIZE) | {"was_visible": np.array([0, 0, 1], np.float32)}
    field = PlaybackField(shape, in_groups(shape, arrays, False))
    field.deform({}, result, np.array([0, 1, 0], np.uint8))
    written = np.isfinite(result["means"]).all(1)
    np.testing.assert_array_equal(written, np.repeat([False, True, True], GROUP_SIZE))
    np.testing.assert_array_equal(result["was_visible"], [0, 1, 0])
