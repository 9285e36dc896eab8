"""Captures that several scenes show, or that a scene shows only through an instance: whose frame they play."""

import bpy
import numpy as np
from support.composed_scene import the_capture
from support.small_scenes import plays, rig_of_three, shows, write_scene
from support.training_panel import switched_off
from support.users_scene import instance_in

from frog_blender import point_cloud
from frog_blender.timeline import handlers


def test_it_plays_the_frame_of_the_scene_that_is_looked_at(empty, capture, static_rig, tmp_path):
    """Not that of the scene which composing made of the same objects, and which stands at its first frame."""
    bpy.ops.frog.compose()
    plays(capture, static_rig, 6)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    shows(capture, static_rig, 5.0)
    bpy.ops.ed.undo_push(message="one")
    bpy.ops.ed.undo_push(message="two")
    bpy.ops.ed.undo()
    shows(the_capture(), static_rig, 5.0)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    shows(the_capture(), static_rig, 5.0)


def test_an_instanced_collection_plays_and_is_saved(empty, capture, static_rig, tmp_path):
    """The capture itself is in no scene: an empty shows its collection, from within another one."""
    collection, around = capture.users_collection[0], bpy.data.collections.new("around")
    empty.collection.children.unlink(collection)
    for holder, held in ((around, collection), (empty.collection, around)):
        instance_in(holder, held)
    plays(capture, static_rig, 6, 3)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    shows(capture, static_rig, 2.0)


def test_what_was_opened_without_the_add_on_plays_when_it_comes(empty, capture, static_rig):
    empty.frame_set(4)
    point_cloud.clear(capture)
    with switched_off():
        """It is a file that nobody plays."""
    assert bpy.app.timers.is_registered(handlers.take_over)
    handlers.take_over()  # no timer runs without a window
    shows(the_capture(), static_rig, 3.0)


def test_each_scene_has_the_background_of_its_own_capture(empty, capture, tmp_path, rendered):
    before = rendered(empty)[0, 0]
    other = bpy.data.scenes.new("Other")
    with bpy.context.temp_override(scene=other):
        path = write_scene(tmp_path / "other.frog", rig_of_three(), background=(0.9, 0.1, 0.1))
        bpy.ops.import_scene.frog(filepath=str(path))
    assert other.world != empty.world
    np.testing.assert_array_equal(rendered(empty)[0, 0], before)
