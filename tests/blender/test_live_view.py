"""A running training's scene in the viewports of the Blender scene that it was started from."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.tasks.training import LiveView, TrainingTask
from frog_blender.timeline import playback_cache
from frog_blender.viewport import live

CAPTURE = "/films/room"


def snapshot(seed=1):
    file = scene_file(400, seed=seed, sh_count=4, moving=100)
    return SceneFile(replace(file.header, capture_path=CAPTURE), file.arrays)


@pytest.fixture
def live_view(empty):
    """A training that goes on, and its view."""
    view = LiveView(empty)
    task = TrainingTask(lambda control: iter(()), live=view)
    task.show()
    return view


def offer(view, seed=1):
    player = ScenePlayer(snapshot(seed))
    view.source.offer(player)
    assert view.update()
    return player


def test_the_newest_snapshot_is_shown_at_the_frame_of_the_timeline(empty, live_view):
    assert live.shown_in(empty) is None and not live_view.update()
    assert bpy.app.background and not live_view.source.is_wanted, "without a window nobody sees it"
    player = offer(live_view)
    frames = player.header.frame_count
    for frame in (1, 3, frames):
        empty.frame_set(frame)
        shown = live.shown_in(empty)
        assert shown.time.scene is player and shown.time.time == pytest.approx((frame - 1) / (frames - 1))
    np.testing.assert_array_equal(shown.matrix, np.eye(4))
    newer = offer(live_view, seed=2)
    assert live.shown_in(empty).time.scene is newer


def test_another_scene_and_a_scene_that_says_no_show_nothing(empty, live_view):
    offer(live_view)
    other = bpy.data.scenes.new("Other")
    assert live.shown_in(other) is None
    empty.frog.show_live = False
    assert live.shown_in(empty) is None
    live_view.update()
    assert not live_view.source.is_wanted, "the training makes no more of them"


def test_what_was_imported_of_the_same_capture_takes_its_place(empty, live_view, tmp_path):
    offer(live_view)
    write_scene(tmp_path / "room.frog", snapshot())
    assert live.shown_in(empty) is not None
    bpy.ops.import_scene.frog(filepath=str(tmp_path / "room.frog"))
    assert live.shown_in(empty) is None


def test_nothing_of_an_earlier_snapshot_stays_in_memory(empty, live_view):
    before = len(playback_cache.frames())
    for seed in range(4):
        offer(live_view, seed)
        live.shown_in(empty).time.part()
        assert len(playback_cache.frames()) == before + 1
    TrainingTask.forget()
    assert len(playback_cache.frames()) == before and live_view.player is None
