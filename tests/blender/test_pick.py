"""A click on splats selects what moves their capture, and one gesture moves, turns, scales, copies or deletes it."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from support.builders import scene_file
from support.users_scene import instance_in

from frog_blender.cameras import pose_of, view_camera
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import write_scene
from frog_blender.operators import pick
from frog_blender.render.collect_instances import visible_captures
from frog_blender.scene_import.capture_objects import cameras_of, root_of
from frog_blender.timeline import playback

WIDTH, HEIGHT = 160, 120


def window(pose):
    """What an operator is given in a window: a viewport that looks as a matrix (4, 4) of Blender's says."""
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1] = 2.0, 2.0 * WIDTH / HEIGHT
    projection[2, 2], projection[2, 3], projection[3, 2] = -1.0, -0.02, -1.0
    view = Matrix(np.linalg.inv(pose).tolist())
    view_data = SimpleNamespace(
        view_matrix=view,
        window_matrix=Matrix(projection.tolist()),
        perspective_matrix=Matrix(projection.tolist()) @ view,
        is_perspective=True,
        view_perspective="PERSP",
    )
    bpy.context.view_layer.update()
    region, names = SimpleNamespace(width=WIDTH, height=HEIGHT), ("scene", "view_layer", "selected_objects")
    there = {name: getattr(bpy.context, name) for name in (*names, "evaluated_depsgraph_get")}
    return SimpleNamespace(region=region, region_data=view_data, space_data=None, **there)


@pytest.fixture
def capture(empty, tmp_path):
    """A dense capture of a still and a moving part."""
    file = scene_file(3000, seed=4, sh_count=4, moving=500)
    file.arrays["opacity_logits"] = np.full_like(file.arrays["opacity_logits"], 3.0)
    write_scene(tmp_path / "a.frog", file)
    assert bpy.ops.import_scene.frog(filepath=str(tmp_path / "a.frog")) == {"FINISHED"}
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = None
    bpy.context.view_layer.update()
    return next(iter(playback.captures(empty.objects)))


@pytest.fixture
def seen(capture):
    """Where a pixel shows nothing but splats, from the capture's first camera, and that pixel."""
    pose = pose_of(ScenePlayer.load(playback.file_of(capture)).header.cameras[0])
    context = window(pose)
    camera = view_camera(context.region_data.view_matrix, context.region_data.window_matrix, WIDTH, HEIGHT)
    alpha = draw(playback.scene_time(capture, 1).gaussians(), camera).alpha
    calm = np.minimum.reduce([np.roll(alpha, (a, b), (0, 1)) for a in range(-3, 4) for b in range(-3, 4)])
    calm[:10], calm[-10:], calm[:, :10], calm[:, -10:] = 0, 0, 0, 0
    row, column = np.unravel_index(calm.argmax(), calm.shape)
    assert calm[row, column] > 0.9
    return pose, (int(column), HEIGHT - 1 - int(row))


def test_a_click_selects_the_root_with_its_splats(capture, seen):
    pose, (x, y) = seen
    context = window(pose)
    hit = pick.splats_at(context, x, y)
    assert hit.obj == capture and 0.1 < hit.depth < 1000 and not pick.is_hidden(context, hit, x, y)
    pick.select(context, hit)
    assert bpy.context.view_layer.objects.active == root_of(capture)
    assert set(bpy.context.selected_objects) == {root_of(capture), capture}
    assert pick.splats_at(context, -1, y) is None and pick.splats_at(context, x, HEIGHT) is None
    away = np.array(pose)
    away[:3, :3] = away[:3, :3] @ np.diag([-1.0, 1.0, -1.0])  # looks the other way
    assert pick.splats_at(window(away), x, y) is None


@pytest.mark.parametrize(("share", "hidden"), [(0.3, True), (3.0, False)])
def test_what_lies_before_the_splats_is_clicked_instead(capture, seen, share, hidden):
    pose, (x, y) = seen
    depth = pick.splats_at(window(pose), x, y).depth
    bpy.ops.mesh.primitive_plane_add(size=1000.0 * depth)
    plane = bpy.context.object
    plane.matrix_world = Matrix(pose.tolist()) @ Matrix.Translation((0.0, 0.0, -share * depth))
    context = window(pose)
    assert pick.is_hidden(context, pick.splats_at(context, x, y), x, y) is hidden


def test_a_collection_s_instance_is_what_is_selected(empty, capture, seen):
    pose, (x, y) = seen
    collection = next(child for child in empty.collection.children if child.name == "a")
    instance = instance_in(empty.collection, collection, (50.0, 0.0, 0.0))
    bpy.context.view_layer.update()
    assert len(visible_captures(bpy.context.evaluated_depsgraph_get())) == 2
    context = window(np.array(Matrix.Translation((50.0, 0.0, 0.0))) @ pose)
    hit = pick.splats_at(context, x, y)
    pick.select(context, hit)
    assert bpy.context.selected_objects == [instance]
    bpy.context.view_layer.layer_collection.children["a"].exclude = True
    context = window(np.array(Matrix.Translation((50.0, 0.0, 0.0))) @ pose)
    assert pick._instancer(context, pick.splats_at(context, x, y)) == instance


def test_it_turns_and_grows_about_its_middle_with_its_cameras(capture):
    root, cameras = root_of(capture), cameras_of(capture)
    np.testing.assert_array_equal(np.array(capture.matrix_world), np.eye(4))
    means = playback.scene_time(capture, 1).gaussians().means
    low, high = np.quantile(means, (0.01, 0.99), axis=0)
    middle = np.array(root.matrix_world.translation)
    np.testing.assert_allclose(middle, (low + high) / 2, rtol=1e-5, atol=1e-5)
    before = [np.array(camera.matrix_world) for camera in cameras]
    turn = Matrix.Rotation(0.7, 4, "Z") @ Matrix.Scale(2.0, 4)
    root.matrix_basis = Matrix.Translation(middle.tolist()) @ turn
    bpy.context.view_layer.update()
    moved = Matrix.Translation(middle.tolist()) @ turn @ Matrix.Translation((-middle).tolist())
    np.testing.assert_allclose(np.array(capture.matrix_world), np.array(moved), atol=1e-5)
    for camera, was in zip(cameras, before, strict=True):
        np.testing.assert_allclose(np.array(camera.matrix_world), np.array(moved) @ was, atol=1e-4)
