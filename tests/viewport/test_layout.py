"""Columns in textures: what the shader fetches is what a frame has, and a frame sends what changes alone."""

from __future__ import annotations

import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.frame_delta import FrameDelta
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.viewport.layout import (
    CHANNELS,
    MOST,
    ROW,
    Texels,
    moving_textures,
    rows_for,
    starts_of,
    still_textures,
    texture_size,
    too_many,
)


def fetched(texels: Texels, count: int, width: int) -> np.ndarray:
    """(count, width) as the shader reads it: texel k is in column k % width and row k // width."""
    image = texels.values.reshape(texels.size[1], texels.size[0], texels.channels)
    each = width // texels.channels
    k = np.arange(count * each)
    return image[k // texels.size[0], k % texels.size[0]].reshape(count, width)


@pytest.mark.parametrize("texels", [0, 1, 2, 63, 64, 65, 4096, 100_001, 48_000_000])
def test_a_texture_is_nearly_square_and_hardly_larger(texels: int) -> None:
    width, height = texture_size(texels)
    assert width * height >= texels and width & (width - 1) == 0
    assert (width * height - texels) < width or texels == 0
    assert height <= 2 * width


def test_what_no_card_holds_is_refused() -> None:
    with pytest.raises(ValueError, match="too many for a texture"):
        texture_size(16_384**2 + 1)


@pytest.mark.parametrize("model", [{}, {"moving": 17}, {"moving": 131, "deformed_sh": 4, "sh_count": 9}], ids=str)
def test_the_shader_reads_the_frame(model: dict) -> None:
    player = ScenePlayer(scene_file(150, **model))
    gaussians, part = player.at(0.37), player.delta_at(0.37)
    still, moving = still_textures(player), moving_textures(player, part)
    widths = {"means": 3, "scales": 3, "quaternions": 4, "base": 4, "sh": 3 * (gaussians.sh.shape[1] - 1)}
    whole = {
        "means": gaussians.means,
        "scales": gaussians.scales,
        "quaternions": gaussians.quaternions,
        "base": np.concatenate([gaussians.sh[:, 0], gaussians.opacities[:, None]], axis=1),
        "sh": gaussians.sh[:, 1:].reshape(150, -1),
    }
    assert set(still) == {name for name, width in widths.items() if width}
    for name, texels in still.items():
        rows = fetched(texels, 150, widths[name])
        if name in moving:
            rows[: player.num_dynamic] = fetched(moving[name], player.num_dynamic, widths[name])
        np.testing.assert_array_equal(rows, whole[name], err_msg=name)
        assert texels.channels == CHANNELS[name]


def test_a_frame_sends_what_changes() -> None:
    player = ScenePlayer(scene_file(5000, moving=1300))
    part = player.delta_at(0.5)
    sent = sum(texels.bytes for texels in moving_textures(player, part).values())
    rows = 4 * 4 * sum(texels.size[0] for texels in moving_textures(player, part).values())
    assert part.bytes <= sent < part.bytes + rows, "but for the last row of each texture"
    assert moving_textures(player, FrameDelta({})) == {}


def test_captures_are_numbered_from_the_beginning_of_a_row() -> None:
    counts = [1, ROW, ROW + 1, 0, 5]
    starts = starts_of(counts)
    assert starts == [0, ROW, 2 * ROW, 4 * ROW, 4 * ROW]
    assert rows_for(starts[-1] + counts[-1]) * ROW >= starts[-1] + counts[-1]
    assert rows_for(0) == rows_for(1) == rows_for(60 * ROW), "a scene may grow a little"
    largest = 1 << 24
    assert starts_of([largest]) == [0] and rows_for(largest) * ROW == largest
    with pytest.raises(FrogError, match=r"16,777,217 splats in 2 captures, expected at most 16,777,216"):
        starts_of([largest, 1])


def test_captures_without_room_are_left_out_and_the_others_are_not() -> None:
    half = MOST // 2
    assert too_many([("a", half), ("b", half)]) == frozenset()
    assert too_many([("a", half), ("b", half + 1), ("c", half)]) == {"b"}, "who comes later may have room"
    assert too_many([("a", half), ("b", half), ("b", 1), ("c", half)]) == {"b"}, "all duplicates or none"
    assert too_many([("a", half), ("b", half)], others=[1]) == {"b"}
    assert too_many([("a", MOST + 1)]) == {"a"} and too_many([("a", MOST)]) == frozenset()


def test_what_is_not_left_out_can_be_numbered() -> None:
    """Each capture begins a row: that counts as well."""
    random = np.random.default_rng(0)
    for _ in range(50):
        counts = [(owner, int(random.integers(1, MOST // 3))) for owner in random.integers(0, 5, 8)]
        left = too_many(counts, [17])
        assert len(starts_of([17, *(count for owner, count in counts if owner not in left)])) >= 2
        for owner in left:
            kept = [count for other, count in counts if other not in left or other == owner]
            with pytest.raises(FrogError):
                starts_of([17, *kept])
