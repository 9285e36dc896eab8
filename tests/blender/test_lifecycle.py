"""What people do to a file: duplicate, rename, delete, append, undo, switch the add-on off, open another file while
training. Nothing crashes, no thread stays, no trained scene is lost."""

from __future__ import annotations

import threading

import bpy
import numpy as np
import pytest
from scenes import rig_of_three, write_scene

from frog_blender import background, carrier, playback
from frog_blender.engine.inference.scene import PlayableScene


def imported(path):
    assert bpy.ops.import_scene.frog(filepath=str(path)) == {"FINISHED"}
    return next(obj for obj in playback.captures(bpy.context.scene.objects) if obj.frog.filepath == str(path))


def shows(obj, path, frame):
    expected = PlayableScene.load(path).at_frame(frame).means
    np.testing.assert_allclose(carrier.read(obj)["position"], expected, atol=1e-6)


def select_only(obj):
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj


def test_a_duplicate_plays_at_its_own_time(empty, static_rig):
    first = imported(static_rig)
    select_only(first)
    bpy.ops.object.duplicate()
    second = bpy.context.object
    assert second != first and second.data != first.data
    second.frog.start_frame = 4.0
    empty.frame_set(6)
    shows(first, static_rig, 5.0)
    shows(second, static_rig, 2.0)
    bpy.data.objects.remove(first)
    empty.frame_set(5)
    shows(second, static_rig, 1.0)


def test_a_renamed_capture_plays_on(empty, static_rig):
    obj = imported(static_rig)
    obj.name, obj.data.name, obj.parent.name = "a", "b", "c"
    empty.frame_set(4)
    shows(obj, static_rig, 3.0)


def test_a_deleted_capture_is_gone_and_comes_back_by_undo(empty, static_rig):
    obj = imported(static_rig)
    name = obj.name
    bpy.ops.ed.undo_push(message="imported")
    select_only(obj)
    bpy.ops.object.delete()
    bpy.ops.ed.undo_push(message="deleted")
    bpy.context.scene.frame_set(3)
    assert name not in bpy.data.objects
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert name in bpy.data.objects
    scene.frame_set(7)
    shows(bpy.data.objects[name], static_rig, 6.0)
    bpy.ops.ed.redo()
    bpy.context.scene.frame_set(2)


def test_appended_and_linked_captures_play(empty, static_rig, tmp_path):
    """Blender lets nobody write linked geometry; FROG draws such a capture from its file."""
    from frog_blender.render_engine import gather

    name = imported(static_rig).name
    blend = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    for link in (False, True):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        with bpy.data.libraries.load(str(blend), link=link) as (there, here):
            here.objects = [name] if name in there.objects else []
        (obj,) = here.objects
        bpy.context.scene.collection.objects.link(obj)
        bpy.context.scene.frame_set(5)
        if not link:
            shows(obj, static_rig, 4.0)
        drawn, _ = gather(bpy.context.evaluated_depsgraph_get())
        np.testing.assert_allclose(drawn.means, PlayableScene.load(static_rig).at_frame(4.0).means, atol=1e-6)


def test_a_moved_folder_plays_on_by_a_relative_path(empty, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    obj = imported(write_scene(here / "x.frog", rig_of_three()))
    bpy.ops.wm.save_as_mainfile(filepath=str(here / "scene.blend"))
    obj.frog.filepath = bpy.path.relpath(obj.frog.filepath)
    assert obj.frog.filepath.startswith("//")
    bpy.ops.wm.save_mainfile()
    here.rename(there)
    bpy.ops.wm.open_mainfile(filepath=str(there / "scene.blend"))
    bpy.context.scene.frame_set(6)
    shows(next(playback.captures(bpy.data.objects)), there / "x.frog", 5.0)


def test_switched_off_and_on_again_in_a_file_with_captures(addon, empty, static_rig):
    obj = imported(static_rig)
    name = obj.name
    addon.unregister()
    try:
        bpy.context.scene.frame_set(5)  # nobody plays it
    finally:
        addon.register()
    bpy.context.scene.frame_set(8)
    shows(bpy.data.objects[name], static_rig, 7.0)


def endless(cancelled):
    from frog_blender.engine.training import events

    while not cancelled():
        yield events.Stage("decoding", 0, 1)
        threading.Event().wait(0.005)
    yield events.Cancelled(0, None)


def test_switched_off_while_training_leaves_no_thread(addon):
    before = threading.active_count()
    task = background.begin(endless)
    assert threading.active_count() == before + 1
    addon.unregister()
    try:
        assert task.join(5.0) and threading.active_count() == before
        assert not bpy.app.timers.is_registered(background._tick)
    finally:
        addon.register()


def test_another_file_while_training_loses_nothing(addon, tmp_path, monkeypatch):
    """A real training of a small filmed scene: what it had learned plays, and can be resumed."""
    pytest.importorskip("torch")
    pytest.importorskip("cv2")
    film = pytest.importorskip("filmed")
    from frog_blender.engine.training import job
    from frog_blender.engine.training.checkpoint import checkpoint_path

    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(job, "stored_seeds", lambda *_, **__: film.seeds())
    capture = film.write_capture(tmp_path / "capture")
    output = tmp_path / "x.frog"
    request = background.TrainingRequest(capture, output, "draft", "auto", steps=100_000)
    task = background.begin(request.events)
    deadline = 2000
    while not task.state.step and deadline:
        task.pump()
        threading.Event().wait(0.01)
        deadline -= 1
    assert task.state.step, task.state.error
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert task.join(0.0) and task.state.cancelled
    assert PlayableScene.load(output).header.steps > 0
    assert checkpoint_path(output).is_file()
    assert not [obj for obj in bpy.data.objects if obj.frog.filepath], "nothing is put into the other file"
