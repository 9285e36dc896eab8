"""What playback asks of the native deformation: groups, kept products; and what cannot be seen is not deformed."""

from __future__ import annotations

import numpy as np
import pytest
from support.builders import pairwise, scene_file
from support.deformation_fields import field_arrays, in_groups, output_arrays

from frog_blender.engine.errors import FrogError
from frog_blender.engine.native import binding
from frog_blender.engine.native.deformation import FieldShape, PlaybackField, deform
from frog_blender.engine.playback.deformation import (
    GROUP_SIZE,
    VisibilityMask,
    mean_deformed_share,
    pack_group_bits,
    sort_by_visibility,
    visible_intervals,
)
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile


def play(
    shape: FieldShape, arrays: dict[str, np.ndarray], result: dict[str, np.ndarray], kept: bool | None = None
) -> None:
    """In groups, unless ``kept`` is None."""
    own = arrays if kept is None else in_groups(shape, arrays, kept)
    PlaybackField(shape, own, bool(kept)).deform({}, result)


@pytest.mark.parametrize(
    ("networks", "hidden", "deformed", "count", "form", "kept"),
    pairwise([1, 2], [1, 33, 64], [0, 1, 4, 16], [1, 5, 16, 97, 1000], ["off", "paper", "unit"], [False, True]),
)
def test_groups_give_the_same(networks: int, hidden: int, deformed: int, count: int, form: str, kept: bool) -> None:
    # A sharpness of 10 would make the rounding of the opacity's change ten times larger.
    shape = FieldShape(0, 16, deformed, form, 1.0, 0.7, 0.5, networks)
    arrays = field_arrays(shape, hidden, 7, count)
    expected, found = output_arrays(shape, count), output_arrays(shape, count)
    found["sh"][:] = arrays["sh"]
    play(shape, arrays, expected)
    play(shape, arrays, found, kept)
    for name, values in expected.items():
        assert np.isfinite(values).all()
        # The exponential makes an absolute error of the logarithm, which may be 4, a relative one.
        rtol = 3e-6 if name == "scales" else 1e-6
        np.testing.assert_allclose(found[name], values, rtol=rtol, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("deformed", [0, 1, 4, 9, 16])
def test_nothing_is_written_beyond_the_last_gaussian(deformed: int) -> None:
    shape = FieldShape(0, deformed, deformed, "unit", 10.0, 1.0, 0.5)
    for count in (1, 15, 16, 17, 96, 97):
        arrays, room = field_arrays(shape, 20, 5, count), output_arrays(shape, count + 1)
        play(shape, arrays, {name: array[:count] for name, array in room.items()}, kept=False)
        for name, array in room.items():
            assert np.isfinite(array[:count]).all() and np.isnan(array[count:]).all(), (name, count)


@pytest.mark.parametrize("kept", [False, True])
def test_the_same_bits_on_any_number_of_threads(kept: bool) -> None:
    try:
        shape, results = FieldShape(0, 9, 4, "unit", 10.0, 1.0, 0.5, 2), []
        arrays = field_arrays(shape, 33, 7, 5000, sh_count=9)
        for threads in (1, 2, 7):
            binding.set_thread_count(threads)
            results.append(output_arrays(shape, 5000) | {"sh": arrays["sh"].copy()})
            play(shape, arrays, results[-1], kept)
        for name, values in results[0].items():
            assert all(result[name].tobytes() == values.tobytes() for result in results)
    finally:
        binding.set_thread_count(0)


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
