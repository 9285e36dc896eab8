"""The cache and its thread: frames ahead are computed in the playing direction, in bounded memory; nothing leaks."""

import threading
from contextlib import nullcontext

import bpy
import pytest
from support.builders import run_python
from support.observed_players import observed
from support.small_scenes import animate, plays, rig_of_three, shows, write_scene
from support.training_panel import endless, switched_off

from frog_blender import point_cloud
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.timeline import playback, playback_cache, prefetch


@pytest.fixture
def capture(capture):
    """Ten frames, shown at 1 to 10."""
    playback_cache.clear()
    yield capture
    playback_cache.worker().stop()
    playback_cache.set_limit(playback_cache.DEFAULT_MEGABYTES)


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "FRoG playback"]


def frames_ahead(scene, obj):
    """The capture's frames that would be computed next, after the scene was shown at its present frame."""
    return [round(shown.time * 9, 4) for shown in prefetch.times_ahead(scene)]


def test_frames_ahead_are_computed_in_another_thread_and_shown_as_they_are(empty, capture, static_rig):
    by_main_thread = []

    def noting(player, time):
        if threading.current_thread() is threading.main_thread():
            by_main_thread.append(time)

    with observed(computing=noting):
        empty.frame_set(1)
        prefetch.prefetch(empty)
        assert playback_cache.worker().wait(20.0) and len(threads()) == 1
        assert len(playback_cache.frames()) == 10
        by_main_thread.clear()
        for frame in (7, 2, 10, 3):
            empty.frame_set(frame)
            shows(capture, static_rig, frame - 1.0)
        assert not by_main_thread
        plays(capture, static_rig, 4.25)  # nobody thought of it
        assert len(by_main_thread) == 1


def test_the_direction_is_the_one_that_was_seen(empty, capture):
    empty.frame_set(4)
    frames_ahead(empty, capture)
    empty.frame_set(5)
    assert frames_ahead(empty, capture) == [5, 6, 7, 8, 9, 0, 1, 2, 3, 4]
    empty.frame_set(4)
    assert frames_ahead(empty, capture)[:5] == [2, 1, 0, 9, 8]
    empty.frame_set(2)
    assert frames_ahead(empty, capture)[:3] == [9, 7, 5], "two at a time, backwards, and round"
    empty.frame_set(1)
    frames_ahead(empty, capture)
    empty.frame_set(10)
    assert frames_ahead(empty, capture)[:3] == [8, 7, 6], "playing backwards went on at the other end"
    empty.frame_set(500)
    assert frames_ahead(empty, capture) == [9], "beyond its end a capture shows one frame"


def test_frames_ahead_follow_each_captures_time(empty, capture):
    empty.frame_set(1)
    settings = capture.frog
    settings.speed = 0.5
    assert frames_ahead(empty, capture)[:3] == [0.5, 1, 1.5]
    settings.speed, settings.repeat, empty.frame_end = 3.0, "LOOP", 40
    assert frames_ahead(empty, capture)[:4] == [3, 6, 9, 2]
    settings.speed, settings.repeat = 1.0, "PING_PONG"
    assert frames_ahead(empty, capture) == [1, 2, 3, 4, 5, 6, 7, 8, 9, 0]
    settings.use_remap = True
    animate(settings, "shown_frame", (1, 9.0), (11, 4.0))
    ahead = frames_ahead(empty, capture)
    assert ahead[9] == pytest.approx(4.0, abs=1e-3) and ahead == sorted(ahead, reverse=True)


def test_a_training_leaves_the_thread_little_to_do(empty, capture):
    """While it runs, not while it is held or after its end; the next frame is there nevertheless."""

    empty.frame_set(3)
    assert len(frames_ahead(empty, capture)) == 10
    playback_cache.clear()
    task = TrainingTask(endless).begin()
    try:
        for frame in (4, 5, 6):
            is_ready = playback_cache.frames().find(playback.displayed(capture, frame).key) is not None
            assert is_ready or frame == 4
            empty.frame_set(frame)
            prefetch.prefetch(empty)
            assert playback_cache.worker().wait(20.0)
            assert len(playback_cache.frames()) == frame - 3 + prefetch.AHEAD_WHILE_TRAINING
        assert frames_ahead(empty, capture) == [6, 7]
        task.control.pause()
        assert len(frames_ahead(empty, capture)) == 10
        task.control.resume()
        assert frames_ahead(empty, capture) == [6, 7]
    finally:
        background_task.stop()
    assert not TrainingTask.is_any_running() and len(frames_ahead(empty, capture)) == 10


def test_memory_is_bounded_and_said(empty, capture, static_rig):
    size = playback.open_scene(static_rig).delta_bytes
    playback_cache.clear()
    playback_cache.frames().set_limit(4 * size)
    empty.frame_set(1)
    assert len(frames_ahead(empty, capture)) == 2, "half of the cache, the rest keeps what was shown"
    for frame in range(1, 11):
        empty.frame_set(frame)
        prefetch.prefetch(empty)
        assert playback_cache.frames().bytes <= 4 * size
    assert playback_cache.worker().wait(20.0) and len(playback_cache.frames()) == 4
    playback_cache.frames().set_limit(0)
    plays(capture, static_rig, 6)
    playback_cache.set_limit(300)
    empty.frame_set(7)
    assert playback_cache.summary() == "Cache: 0 MB of 300 MB, 1 frames"
    playback_cache.clear()
    assert len(playback_cache.frames()) == 0
    plays(capture, static_rig, 7)


@pytest.mark.parametrize("how", ["another file", "add-on off"])
def test_the_thread_ends(empty, capture, how):
    prefetch.prefetch(empty)
    assert len(threads()) == 1
    if how == "another file":
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with nullcontext() if how == "another file" else switched_off():
        assert not threads() and len(playback_cache.frames()) == 0


def test_the_thread_survives_what_cannot_be_computed(empty, capture, static_rig, capfd):
    broken = [True]

    def failing(player, time):
        if broken:
            raise MemoryError("none left")

    with observed(computing=failing):
        prefetch.prefetch(empty)
        assert playback_cache.worker().wait(20.0)
        assert "MemoryError: none left" in capfd.readouterr().err
        broken.clear()
        prefetch.prefetch(empty)
        assert playback_cache.worker().wait(20.0) and len(playback_cache.frames()) >= 9


def test_blender_quits_with_a_thread_at_work(tmp_path):
    if bpy.app.binary_path:
        pytest.skip("a real Blender runs no second interpreter with bpy")
    path = write_scene(tmp_path / "x.frog", rig_of_three(), count=30_000)
    code = """
import atexit, os, sys, threading, bpy, frog_blender
atexit.register(os._exit, 0)  # after the add-on's: bpy 4.5 may wait for a thread of its own for ever
from frog_blender.timeline import prefetch
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
frog_blender.register()
bpy.ops.import_scene.frog(filepath=sys.argv[1])
prefetch.prefetch(bpy.context.scene)
print("busy", "FRoG playback" in {thread.name for thread in threading.enumerate()}, flush=True)
"""
    run = run_python(code, path)
    assert run.returncode == 0 and "busy True" in run.stdout, run.stdout + run.stderr


# What is not written again must be right nevertheless.


def test_a_duplicate_that_shows_something_else_has_its_own_geometry(empty, capture, static_rig, tmp_path):
    twin = capture.copy()  # shares the mesh
    empty.collection.objects.link(twin)
    other = write_scene(tmp_path / "other.frog", rig_of_three(), seed=4)
    twin.frog.filepath = str(other)
    for frame in (2, 2, 5):
        playback.show(capture, frame)
        shows(capture, static_rig, frame - 1.0)
        playback.show(twin, frame)
        shows(twin, other, frame - 1.0)
        shows(capture, static_rig, frame - 1.0)
    assert twin.data != capture.data
    twin.data = capture.data.copy()
    playback.show(capture, 4)
    playback.show(twin, 4)
    shows(capture, static_rig, 3.0)
    shows(twin, other, 3.0)
    twin.data = capture.data.copy()  # says that it is the first file's
    playback.show(twin, 6)
    shows(twin, other, 5.0)
    shows(capture, static_rig, 3.0)


def test_what_undo_brings_back_is_written_anew(empty, capture, static_rig, tmp_path):
    other = write_scene(tmp_path / "other.frog", rig_of_three(), seed=4)
    bpy.ops.ed.undo_push(message="first")
    capture.frog.filepath = str(other)
    bpy.context.scene.frame_set(6)
    bpy.ops.ed.undo_push(message="other file")
    for step, path in ((bpy.ops.ed.undo, static_rig), (bpy.ops.ed.redo, other), (bpy.ops.ed.undo, static_rig)):
        step()
        obj = next(playback.captures(bpy.context.scene.objects))
        plays(obj, path, 2, 9)


def disturb(capture, seed):
    """Changes the geometry that is being edited, by an operator of its own."""
    if capture.type == "MESH":
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.sort_elements(type="RANDOMIZE", elements={"VERT"}, seed=seed)
    else:
        bpy.ops.pointcloud.select_all(action="DESELECT")
        bpy.ops.pointcloud.select_random(seed=seed)
        bpy.ops.pointcloud.delete()


def test_geometry_that_somebody_changed_is_written_anew(empty, capture, static_rig):
    bpy.context.view_layer.objects.active = capture
    empty.frame_set(2)
    bpy.ops.object.mode_set(mode="EDIT")
    disturb(capture, 3)
    empty.frame_set(4)  # in edit mode there is nothing to write to
    bpy.ops.object.mode_set(mode="OBJECT")
    plays(capture, static_rig, 5, 6)
    bpy.ops.object.mode_set(mode="EDIT")
    disturb(capture, 4)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    plays(capture, static_rig, 7)
    capture.data.attributes.remove(capture.data.attributes["scale"])
    plays(capture, static_rig, 7)


def test_saved_geometry_of_another_session_is_not_trusted(empty, capture, static_rig, tmp_path):
    """The file is missing while saving, so the mesh is in the .blend; then another one takes its place."""
    static_rig.unlink()
    empty.frame_set(2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    name = capture.name
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert point_cloud.count(bpy.data.objects[name]) == 60
    write_scene(static_rig, rig_of_three(), seed=11)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    shows(bpy.data.objects[name], static_rig, 1.0)
    plays(bpy.data.objects[name], static_rig, 8)
