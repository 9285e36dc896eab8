"""A render goes through frames in its own thread while windows draw: what it may write then, and what it shares."""

import copy
import sys
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from support.small_scenes import shows

from frog_blender import addon_state, point_cloud, reported_once
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline import handlers, level_of_detail, open_scenes, playback, render_thread


@pytest.fixture
def in_window(monkeypatch):
    """As if the Blender that runs the tests had windows, where a render has a thread of its own."""

    monkeypatch.setattr(render_thread, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))


def in_another_thread(function):
    with ThreadPoolExecutor(1) as pool:
        pool.submit(function).result()


def points(obj):
    return point_cloud.read(obj)["position"]


@pytest.mark.parametrize("locked", [True, False])
def test_points_are_written_from_a_renders_thread_only_while_windows_are_locked(
    empty, capture, static_rig, in_window, locked, capfd
):
    reported_once.forget()
    empty.render.engine, empty.render.use_lock_interface = "CYCLES", locked
    empty.frame_current = 5  # as a render sets it, without the handlers of this thread
    in_another_thread(lambda: handlers.on_frame(empty))
    frame = 4.0 if locked else 0.0
    assert ("do not move" in capfd.readouterr().err) != locked
    shows(capture, static_rig, frame)
    handlers.on_frame(empty)
    shows(capture, static_rig, 4.0)


def test_never_for_the_frog_engine(empty, capture, in_window):
    handlers.on_render_begin(empty)
    try:
        before = points(capture)
        empty.frame_current = 5
        in_another_thread(lambda: handlers.on_frame(empty))
        np.testing.assert_array_equal(points(capture), before)
        handlers.on_frame(empty)  # scrubbed meanwhile
        assert np.abs(points(capture) - before).max() > 0
    finally:
        handlers.on_render_end()


@pytest.fixture
def written(capture, monkeypatch):
    """Whether a render was under way, for each attribute that was written."""
    found, write = [], point_cloud.write_attribute

    def noting(*given):
        found.append(render_thread.rendering().is_under_way)
        write(*given)

    monkeypatch.setattr(point_cloud, "write_attribute", noting)
    return found


def test_an_animation_by_frog_writes_no_points_and_leaves_the_right_ones(empty, capture, static_rig, tmp_path, written):
    empty.render.use_motion_blur = True
    empty.frame_start, empty.frame_end = 3, 5
    empty.render.resolution_percentage = 25
    empty.render.filepath = str(tmp_path / "film_")
    bpy.ops.render.render(animation=True)
    assert len(list(tmp_path.glob("film_*"))) == 3 and not any(written)
    shows(capture, static_rig, empty.frame_current - 1.0)


def test_threads_share_what_is_kept_of_files(empty, capture, tmp_path, monkeypatch):
    """A render's thread and Blender's own ask for scenes and thinned scenes while others are dropped."""
    ready = ScenePlayer.load(playback.file_of(capture))
    open_scenes.forget()
    # Reading takes long and is not looked at here.
    addon_state.put(open_scenes.OpenScenes(lambda path: copy.copy(ready)))
    paths = [tmp_path / f"{index}.frog" for index in range(40)]
    for path in paths:
        path.touch()
    capture.frog.density = 10
    stop = threading.Event()

    def ask(index):
        for turn in range(20):
            path = paths[(10 * index + turn) % len(paths)]
            scene = open_scenes.scene(path)
            assert level_of_detail.thinned(capture, scene).count == 6
            assert open_scenes.problem(path) == "" and not open_scenes.is_missing(path)

    def drop():
        while not stop.is_set():
            open_scenes.forget_all_but(paths[:2])
            open_scenes.forget()

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(5) as pool:
            dropping, asking = pool.submit(drop), [pool.submit(ask, index) for index in range(4)]
            wait(asking)
            stop.set()
            for done in (dropping, *asking):
                done.result()
    finally:
        sys.setswitchinterval(before)
        addon_state.reset(open_scenes.OpenScenes)
