"""Ellipsoids: an instance for every Gaussian, where, how large and turned as the engine has it at every frame."""

import bpy
import mathutils
import numpy as np
from support.builders import blobs
from support.users_scene import eye_in

from frog_blender import point_cloud
from frog_blender.engine.native.options import ALPHA_MIN
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.render import collect_instances


def instances(obj):
    """(N, 4, 4) world matrices of the object's instances, in their order."""
    graph = bpy.context.evaluated_depsgraph_get()
    made = (instance for instance in graph.object_instances if instance.is_instance and instance.parent is not None)
    return np.array([np.array(instance.matrix_world) for instance in made if instance.parent.original == obj])


def test_every_instance_is_its_gaussian(empty, capture, static_rig):
    obj, turn = capture, mathutils.Quaternion((0.9, 0.1, 0.4, 0.2))
    obj.parent.matrix_world = mathutils.Matrix.LocRotScale((1.0, 2.0, 3.0), turn, None)
    obj.frog.display = "ELLIPSOIDS"
    scene = ScenePlayer.load(static_rig)
    for frame in (1, 5, 3, 2.5, 6):
        empty.frame_set(int(frame), subframe=frame % 1)
        gaussians = scene.at_frame(frame - 1)
        turns = [mathutils.Quaternion(q).normalized().to_matrix() for q in gaussians.quaternions.astype(float)]
        expected = np.tile(np.eye(4), (len(gaussians), 1, 1))
        expected[:, :3, :3] = np.array(turns) * gaussians.scales[:, None, :]
        expected[:, :3, 3] = gaussians.means
        expected = expected[gaussians.opacities >= ALPHA_MIN]
        found = instances(obj)
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, np.array(obj.matrix_world) @ expected, atol=2e-5)


def test_nobody_sees_what_is_transparent(empty):
    means = np.arange(15, dtype=np.float32).reshape(5, 3)
    obj = point_cloud.create("five", blobs(means, 1.0, opacities=[0.9, 0.0, 0.5, 0.003, 0.004]))
    point_cloud.display(obj, "ELLIPSOIDS")
    empty.collection.objects.link(obj)
    np.testing.assert_array_equal(instances(obj)[:, :3, 3], means[[0, 2, 4]])


def test_ellipsoids_have_the_gaussians_colours(empty, rendered):
    """One red and one green Gaussian, seen by Cycles."""
    obj = point_cloud.create("two", blobs([(-1, 0, 0), (1, 0, 0)], 0.4, colors=np.eye(3)[:2]))
    point_cloud.display(obj, "ELLIPSOIDS")
    empty.collection.objects.link(obj)
    eye_in(empty, (0, -6, 0), (np.pi / 2, 0, 0))
    empty.render.engine = "CYCLES"
    empty.cycles.device, empty.cycles.samples, empty.cycles.use_denoising = "CPU", 4, False
    empty.view_settings.view_transform = "Standard"
    pixels = rendered(empty, resolution_x=90, resolution_y=40, resolution_percentage=100).astype(int)
    left, right = pixels[20, :45, :3], pixels[20, 45:, :3]
    assert left[left.sum(1).argmax()].argmax() == 0 and left.max() > 240
    assert right[right.sum(1).argmax()].argmax() == 1 and right.max() > 240


def test_frog_draws_the_capture_once_however_it_is_shown(empty, capture, rendered):
    obj = capture
    before, points = rendered(empty), len(instances(obj))
    obj.frog.display = "ELLIPSOIDS"
    assert len(instances(obj)) > max(30, points)
    found = collect_instances.visible_captures(bpy.context.evaluated_depsgraph_get())
    assert [capture for capture, *_ in found] == [obj]
    np.testing.assert_array_equal(rendered(empty), before)
    obj.frog.display = "POINTS"
    assert len(instances(obj)) == points
    modifiers = len(obj.modifiers)
    point_cloud.draw_in("render", obj, False)
    np.testing.assert_array_equal(rendered(empty), before)
    point_cloud.draw_in("render", obj, True)
    assert len(obj.modifiers) == modifiers
