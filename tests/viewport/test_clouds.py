"""Scenes on the graphics card: what is there is not sent again."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.builders import scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile
from frog_blender.viewport.clouds import Clouds
from frog_blender.viewport.layout import Texels

cache = pytest.importorskip("frog_blender.timeline.playback_cache", reason="needs bpy")


class CountingCard:
    def __init__(self) -> None:
        self.sent: list[Texels] = []

    def texture(self, texels: Texels) -> Texels:
        self.sent.append(texels)
        return texels

    def bytes(self) -> int:
        found, self.sent = sum(texels.bytes for texels in self.sent), []
        return found


def test_a_scene_is_sent_once_and_of_a_frame_what_changes() -> None:
    player, card, clouds = ScenePlayer(scene_file(3000, moving=500)), CountingCard(), Clouds()
    cloud = clouds.of(player, card)
    whole = card.bytes()
    assert whole >= 3000 * 14 * 4
    first = cloud.at(cache.SceneTime(player, 0.25))
    part = card.bytes()
    assert 500 * 14 * 4 <= part < 0.3 * whole
    assert cloud.at(cache.SceneTime(player, 0.25)).moving is first.moving and card.bytes() == 0
    assert clouds.of(player, card) is cloud and card.bytes() == 0
    assert first.rows == 500 and first.still.keys() == first.moving.keys() | {"sh"} & first.still.keys()
    cloud.at(cache.SceneTime(player, 0.5))
    assert card.bytes() == part


def test_what_was_there_does_not_change_what_is_shown() -> None:
    player, card, clouds = ScenePlayer(scene_file(300, moving=50)), CountingCard(), Clouds()
    cloud = clouds.of(player, card)
    times = [0.0, 0.7, 0.2, 0.9, 0.4, 0.7, 1.0]
    shown = [cloud.at(cache.SceneTime(player, time)).moving["means"].values.copy() for time in times]
    for time, values in zip(times, shown, strict=True):
        alone = Clouds().of(player, CountingCard()).at(cache.SceneTime(player, time))
        assert (alone.moving["means"].values == values).all()


def test_a_static_scene_sends_nothing_more() -> None:
    scene = scene_file(20)
    player = ScenePlayer(SceneFile(replace(scene.header, method="static", model={}), scene.arrays))
    card, clouds = CountingCard(), Clouds()
    cloud = clouds.of(player, card)
    card.bytes()
    assert cloud.at(cache.SceneTime(player, 0.0)).rows == 0 and card.bytes() == 0


def test_other_scenes_leave_the_card() -> None:
    players, clouds = [ScenePlayer(scene_file(20)) for _ in range(3)], Clouds()
    card = CountingCard()
    for player in players:
        clouds.of(player, card)
    clouds.keep_only([players[1].token])
    assert len(clouds) == 1
    card.bytes()
    clouds.of(players[1], card)
    assert card.bytes() == 0
