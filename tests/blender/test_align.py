"""Align to Floor: the capture ends upright on the grid, everything with it, at the size that was asked for."""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Vector
from support.builders import blobs, refuses, still_scene
from support.small_scenes import lens, looking_at

from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.scene.scene_file import write_scene
from frog_blender.scene_import.capture_objects import active_capture, cameras_of
from frog_blender.timeline import playback
from frog_blender.timeline.edits import store_marks

HEIGHT = -0.4  # of the floor in the capture's own space, where z is up before it is turned


@pytest.fixture
def turned(empty, tmp_path):
    """A capture whose floor and cameras are turned, imported; and that turn."""
    turn = np.array(Euler((1.1, -0.4, 2.0)).to_matrix())
    random, angles = np.random.default_rng(1), np.linspace(-1, 1, 6)
    eyes = np.stack([4 * np.sin(angles), -4 * np.cos(angles), np.full(6, 1.5)], axis=1) @ turn.T
    seen = {"size": (64, 48), "intrinsics": lens(60.0, 60.0, 32.0, 24.0), "up": turn[:, 2]}
    rig = [looking_at(f"c{i}", eye, **seen) for i, eye in enumerate(eyes)]
    means = np.concatenate([random.uniform(-1, 1, (600, 3)) * [2, 2, 0], random.normal([0, 0, 0.9], 0.2, (300, 3))])
    means += random.normal([0.5, 0.2, HEIGHT], 0.004, means.shape)
    write_scene(tmp_path / "x.frog", still_scene(blobs(means @ turn.T, opacities=0.95), rig))
    assert bpy.ops.import_scene.frog(filepath=str(tmp_path / "x.frog")) == {"FINISHED"}
    return active_capture(bpy.context), turn


def align(**options):
    assert bpy.ops.frog.align_to_floor(**options) == {"FINISHED"}
    bpy.context.view_layer.update()


def up_of(obj, turn):
    """Where the capture's up points in the world."""
    up = obj.matrix_world.to_3x3() @ Vector(turn[:, 2])
    return np.array(up) / up.length


def floor_of(obj, turn):
    """Where the capture's floor is in the world, below the middle of its things."""
    return np.array(obj.matrix_world @ Vector(turn @ [0.5, 0.2, HEIGHT]))


def test_it_stands_on_the_grid_at_the_origin(turned):
    obj, turn = turned
    eye = cameras_of(obj)[0].matrix_world.inverted() @ obj.matrix_world
    align()
    np.testing.assert_allclose(up_of(obj, turn), [0, 0, 1], atol=5e-3)
    assert np.all(np.abs(floor_of(obj, turn)) < [0.15, 0.15, 0.02])
    assert np.allclose(cameras_of(obj)[0].matrix_world.inverted() @ obj.matrix_world, eye, atol=1e-5)
    forward = np.mean([np.array(camera.matrix_world)[:3, 2] for camera in cameras_of(obj)], axis=0)
    assert forward[1] < -0.5 and abs(forward[0]) < 0.05, "the cameras look along +y on the whole"


def test_what_is_hidden_holds_no_floor(turned):
    obj, turn = turned
    scene = playback.open_scene(playback.file_of(obj))
    store_marks(obj.frog_edits.hidden, Marks.of(scene, np.arange(900) < 600))
    align()
    assert floor_of(obj, turn)[2] < -0.1


def test_the_cameras_alone(turned):
    obj, turn = turned
    align(use_floor=False)
    np.testing.assert_allclose(up_of(obj, turn), [0, 0, 1], atol=1e-5)
    assert abs(floor_of(obj, turn)[2]) < 0.05


def test_the_scale_stays_or_makes_a_distance_as_long_as_told(turned):
    obj, turn = turned
    obj.parent.scale = (3.0, 3.0, 3.0)
    align()
    np.testing.assert_allclose(obj.matrix_world.to_scale(), 3.0, rtol=1e-5)
    align(use_length=True, length=7.0)  # between the cameras farthest apart
    first, last = cameras_of(obj)[0], cameras_of(obj)[-1]
    assert (first.matrix_world.translation - last.matrix_world.translation).length == pytest.approx(7.0, rel=1e-5)
    bpy.ops.object.select_all(action="DESELECT")
    second = cameras_of(obj)[1]
    first.select_set(True)
    second.select_set(True)
    bpy.context.view_layer.objects.active = first  # one of the capture's objects names it
    align(use_length=True, length=0.5)
    assert (first.matrix_world.translation - second.matrix_world.translation).length == pytest.approx(0.5, rel=1e-5)
    np.testing.assert_allclose(floor_of(obj, turn)[2], 0, atol=0.02)


def test_what_cannot_be_aligned_is_refused_with_a_sentence(turned, tmp_path):
    obj, _ = turned
    before = obj.parent.matrix_world.copy()
    obj.parent.scale = (0.0, 0.0, 0.0)
    refuses("scale of zero", bpy.ops.frog.align_to_floor)
    obj.parent.scale = (1.0, 1.0, 1.0)
    obj.frog.filepath = str(tmp_path / "missing.frog")
    refuses("found no file", bpy.ops.frog.align_to_floor)
    bpy.context.view_layer.update()
    assert obj.parent.matrix_world == before
