"""Scenes in the card's textures: what the shader fetches is what a frame has, and what is there is not sent again."""

from dataclasses import replace

import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.playback.frame_delta import column_of
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile
from frog_blender.viewport import clouds
from frog_blender.viewport.clouds import MOST, ROW, Clouds, Texels, TooManySplats, rows_for, starts_of, texture_size

cache = pytest.importorskip("frog_blender.timeline.playback_cache", reason="needs bpy")


class CountingCard:
    def __init__(self) -> None:
        self.sent: list[Texels] = []

    def texture(self, texels: Texels) -> Texels:
        self.sent.append(texels)
        return texels

    def bytes(self) -> int:
        found, self.sent = sum(texels.values.nbytes for texels in self.sent), []
        return found


def fetched(texels: Texels, count: int, width: int) -> np.ndarray:
    """(count, width) as the shader reads it: texel k is in column k % width and row k // width."""
    image = texels.values.reshape(texels.size[1], texels.size[0], texels.channels)
    k = np.arange(count * width // texels.channels)
    return image[k // texels.size[0], k % texels.size[0]].reshape(count, width)


@pytest.mark.parametrize("model", [{}, {"moving": 17}, {"moving": 131, "deformed_sh": 4, "sh_count": 9}], ids=str)
def test_the_shader_reads_the_frame(model: dict) -> None:
    player = ScenePlayer(scene_file(150, **model))
    cloud = Clouds().of(player, CountingCard())
    for time in (0.37, 0.8, 0.1, 0.37, 0.9, 0.0):  # some of which are remembered
        gaussians, shown = player.at(time), cloud.at(cache.SceneTime(player, time))
        whole = {name: column_of(gaussians, name) for name in ("means", "scales", "quaternions", "base")}
        whole["sh"] = gaussians.sh[:, 1:].reshape(150, -1)
        assert set(shown.still) == {name for name, values in whole.items() if values.size}
        for name, texels in shown.still.items():
            rows = fetched(texels, 150, whole[name].shape[1])
            if name in shown.moving:
                rows[: shown.rows] = fetched(shown.moving[name], shown.rows, whole[name].shape[1])
            np.testing.assert_array_equal(rows, whole[name], err_msg=name)


def test_a_scene_is_sent_once_and_of_a_frame_what_changes() -> None:
    player, card, kept = ScenePlayer(scene_file(3000, moving=500)), CountingCard(), Clouds()
    cloud = kept.of(player, card)
    whole = card.bytes()
    assert whole >= 3000 * 14 * 4
    first = cloud.at(cache.SceneTime(player, 0.25))
    part = card.bytes()
    assert player.delta_bytes <= part < 0.3 * whole
    assert cloud.at(cache.SceneTime(player, 0.25)).moving is first.moving and kept.of(player, card) is cloud
    assert card.bytes() == 0 and first.rows == 500
    cloud.at(cache.SceneTime(player, 0.5))
    assert card.bytes() == part


def test_a_static_scene_sends_nothing_more_and_others_leave_the_card() -> None:
    scene, card, kept = scene_file(20), CountingCard(), Clouds()
    player = ScenePlayer(SceneFile(replace(scene.header, method="static", model={}), scene.arrays))
    cloud = kept.of(player, card)
    kept.of(ScenePlayer(scene), card)
    card.bytes()
    assert cloud.at(cache.SceneTime(player, 0.0)).rows == 0 and card.bytes() == 0
    kept.keep_only([player.token])
    assert len(kept) == 1 and kept.of(player, card) is cloud and card.bytes() == 0


@pytest.mark.parametrize("texels", [0, 1, 63, 64, 65, 100_001, 48_000_000])
def test_a_texture_is_nearly_square_and_hardly_larger(texels: int) -> None:
    width, height = texture_size(texels)
    assert width & (width - 1) == 0 and height <= 2 * width
    assert texels <= width * height < texels + width or texels == 0


def test_what_no_card_holds_is_refused() -> None:
    with pytest.raises(ValueError, match="too many for a texture"):
        texture_size(16_384**2 + 1)
    assert starts_of([MOST]) == [0] and rows_for(MOST) * ROW == MOST == 1 << 24, "a float32 holds their numbers"
    with pytest.raises(TooManySplats, match=r"16,777,217 splats in 2 captures, expected at most 16,777,216"):
        starts_of([MOST, 1])


def test_captures_are_numbered_from_the_beginning_of_a_row() -> None:
    counts = [1, ROW, ROW + 1, 0, 5]
    starts = starts_of(counts)
    assert starts == [0, ROW, 2 * ROW, 4 * ROW, 4 * ROW]
    assert rows_for(starts[-1] + counts[-1]) * ROW >= starts[-1] + counts[-1]
    assert rows_for(0) == rows_for(60 * ROW) == clouds._ROWS_AT_ONCE, "a scene may grow a little"
