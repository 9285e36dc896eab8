"""When and how fast a capture plays: fitted to the scene, and the scene to it."""

from __future__ import annotations

import bpy
import pytest

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline import playback
from frog_blender.ui import timing_panel


def test_half_speed_takes_twice_the_frames(empty, capture):
    count = ScenePlayer.load(playback.file_of(capture)).header.frame_count
    assert (empty.frame_start, empty.frame_end) == (1, count)
    assert timing_panel._told_of_frames(capture, empty) == ""
    capture.frog.speed = 0.5
    told = timing_panel._told_of_frames(capture, empty)
    assert f"Plays in frames 1 to {2 * count - 1}. The scene has 1 to {count}." in told and "0.5 times" in told
    assert bpy.ops.frog.fit_frame_range() == {"FINISHED"}
    assert (empty.frame_start, empty.frame_end) == (1, 2 * count - 1)
    assert playback.shown_frame(capture, empty.frame_end) == count - 1
    capture.frog.start_frame, capture.frog.speed = 100.0, -1.0
    assert bpy.ops.frog.fit_frame_range() == {"FINISHED"}
    assert (empty.frame_start, empty.frame_end) == (101 - count, 100)


@pytest.mark.parametrize(("rate", "base", "stretch"), [(24, 1.0, 100), (30, 1.001, 100), (25, 1.0, 200)])
def test_real_time_is_that_of_the_film(empty, capture, rate, base, stretch):
    header = ScenePlayer.load(playback.file_of(capture)).header
    empty.render.fps, empty.render.fps_base, empty.render.frame_map_new = rate, base, stretch
    assert bpy.ops.frog.play_in_real_time() == {"FINISHED"}
    assert bpy.ops.frog.fit_frame_range() == {"FINISHED"}
    seconds = header.frame_count / header.frames_per_second
    frames = empty.frame_end - empty.frame_start + 1
    assert abs(frames * base / rate - seconds) < 2 * base / rate + 1 / header.frames_per_second
    empty.frame_set(empty.frame_start)
    first = playback.shown_frame(capture, empty.frame_current_final)
    empty.frame_set(empty.frame_start + round(rate / base))
    shown = playback.shown_frame(capture, empty.frame_current_final) - first
    assert shown == pytest.approx(header.frames_per_second, rel=0.05), "in a second"


def test_what_cannot_be_fitted_is_grey(empty, capture, static_rig):
    capture.frog.use_remap = True
    assert not bpy.ops.frog.fit_frame_range.poll() and not bpy.ops.frog.play_in_real_time.poll()
    capture.frog.use_remap, capture.frog.speed = False, 0.0
    assert not bpy.ops.frog.fit_frame_range.poll() and bpy.ops.frog.play_in_real_time.poll()
    capture.frog.speed = 1e-9
    with pytest.raises(RuntimeError, match="which no scene has"):
        bpy.ops.frog.fit_frame_range()
    bpy.data.objects.remove(capture)
    assert not bpy.ops.frog.fit_frame_range.poll()
