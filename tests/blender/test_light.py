"""Light Objects by This Capture: which light arrives where, what cameras still see, and the way back."""

import bpy
import numpy as np
import pytest
from support.composed_scene import compose, splats_of
from support.exr import pass_of, render_channels
from support.small_scenes import channels_of, of_one_shader, rig_of_three, world_of, write_scene
from support.users_scene import eye_in, users_scene

from frog_blender.engine.playback.environment import environment, free_place
from frog_blender.lighting import world
from frog_blender.point_cloud import middle_of
from frog_blender.render.world import background_of
from frog_blender.timeline import playback


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path / "scene.frog", rig_of_three(), count=200)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(world, "WIDTH", 128)


def light():
    assert bpy.ops.frog.light_objects() == {"FINISHED"}


def image_of(lit):
    return next(node.image for node in lit.node_tree.nodes if node.type == "TEX_ENVIRONMENT" and node.image)


def pixels_of(image):
    """(H, W, 3), rows from the top."""
    return channels_of(image)[..., :3]


def in_cycles(scene, place, look, tmp_path):
    """(H, W, 4) scene-linear pixels of Cycles' render of a scene by a narrow camera."""
    eye_in(scene, place, look, angle=0.02, clip_start=0.001)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.render.resolution_percentage, scene.render.film_transparent = 100, False
    scene.world.cycles.sampling_method = "NONE"  # or Cycles makes a large table of it for each image
    return pass_of(render_channels(scene, tmp_path / "out.exr"), "Combined", "RGBA")


def mirror(scene):
    """A mirror in the plane z = 0 that reflects what is above it."""
    mesh = bpy.data.meshes.new("mirror")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(of_one_shader("ShaderNodeBsdfAnisotropic", Roughness=0.0, Color=(1, 1, 1, 1)))
    scene.collection.objects.link(bpy.data.objects.new("mirror", mesh))


def test_light_arrives_from_where_the_capture_shows_it(empty, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(world, "free_place", lambda *_: np.zeros(3))  # among the Gaussians, which differ
    light()
    mirror(empty)
    capture.hide_render = True
    seen = []
    for turn in (0.4, 1.1, 2.3, 5.5):  # seen at 45 degrees from above, it reflects what lies at 45 degrees above
        place = np.array([np.sin(turn), -np.cos(turn), 1.0]) * 2
        found = in_cycles(empty, place.tolist(), (np.pi / 4, 0, turn), tmp_path)[..., :3].mean((0, 1))
        ray = np.array([-np.sin(turn), np.cos(turn), 1.0]) / np.sqrt(2)
        across, up = 0.5 - np.arctan2(ray[1], ray[0]) / (2 * np.pi), np.arcsin(ray[2]) / np.pi + 0.5
        panorama = pixels_of(image_of(empty.world))
        expected = panorama[int((1 - up) * 64), int((across % 1) * 128)]
        np.testing.assert_allclose(found, expected, atol=0.02)
        seen.append(expected)
    assert np.ptp(seen, axis=0).max() > 0.1, "there is something to be told apart"


def test_the_image_is_what_the_engine_sees_from_there(empty, capture):
    empty.frame_set(4)
    light()
    gaussians, camera = playback.scene_time(capture, 4).gaussians(), world.AHEAD.copy()
    camera[:3, 3] = -camera[:3, :3] @ free_place(gaussians, *middle_of(gaussians.means))
    found = pixels_of(image_of(empty.world)).copy()
    expected = environment(gaussians, camera, 128)
    np.testing.assert_allclose(found, expected, atol=1e-3)
    capture.parent.location.x += 3.0  # the place moves with it
    bpy.context.view_layer.update()
    light()
    np.testing.assert_allclose(pixels_of(image_of(empty.world)), found, atol=0.02)


def test_cameras_and_frog_see_the_world_as_before(empty, capture, tmp_path):
    color = np.array([0.3, 0.05, 0.2])
    empty.world = own = world_of("Mine", tuple(color))
    seen = background_of(empty, np.zeros(3))
    light()
    assert empty.world != own
    np.testing.assert_array_equal(background_of(empty, np.zeros(3)), seen)
    capture.hide_render = True
    found = in_cycles(empty, (0, 0, 50), (0, 0, 0), tmp_path)
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(color, (4, 4, 3)), atol=1e-3)


def test_one_click_brings_the_own_world_back(empty, capture, tmp_path, monkeypatch):
    own = users_scene(empty)
    nodes = [node.type for node in own.node_tree.nodes]
    assert not bpy.ops.frog.use_own_world.poll()
    light()
    lit = empty.world
    world.light_node(lit).inputs["Strength"].default_value = 2.5
    before = pixels_of(image_of(lit)).copy()
    empty.frame_set(8)
    monkeypatch.setattr(world, "WIDTH", 256)
    light()
    assert empty.world == lit and empty.frog.own_world == own
    assert world.light_node(lit).inputs["Strength"].default_value == 2.5
    assert tuple(image_of(lit).size) == (256, 128) and before.shape == (64, 128, 3)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    kept = pixels_of(image_of(lit)).copy()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    scene = bpy.context.scene
    assert image_of(scene.world).packed_file is not None
    np.testing.assert_array_equal(pixels_of(image_of(scene.world)), kept)
    assert bpy.ops.frog.use_own_world() == {"FINISHED"}
    assert scene.world.name == "My studio lights" and not world.is_lit(scene)
    assert [node.type for node in scene.world.node_tree.nodes] == nodes
    assert scene.frog.own_world is None


def test_a_world_that_took_its_place_is_the_own_one(empty, capture):
    first = users_scene(empty)
    light()
    nodes = empty.world.node_tree.nodes
    nodes.remove(next(node for node in nodes if node.type == "TEX_ENVIRONMENT"))
    light()  # a removed texture is made again
    assert world.light_node(empty.world).inputs["Color"].links[0].from_node.image == image_of(empty.world)
    empty.world = second = bpy.data.worlds.new("Second")
    light()
    assert empty.frog.own_world == second and first.use_fake_user
    bpy.ops.frog.use_own_world()
    assert empty.world == second


def test_objects_are_lit_in_composed_renders(empty, capture, tmp_path):
    compose(empty)
    splats = splats_of(empty)
    bpy.context.window.scene = splats
    try:
        light()
    finally:
        bpy.context.window.scene = empty
    bpy.context.view_layer.update()
    assert world.is_lit(empty) and splats.world == empty.world


def test_other_images_are_never_overwritten(empty, capture):
    light()
    former = image_of(empty.world)
    before = pixels_of(former).copy()
    former.use_fake_user = True
    empty.frame_set(8)
    light()
    assert image_of(empty.world) != former
    np.testing.assert_array_equal(pixels_of(former), before)
    users = bpy.data.images.new("Mine", 128, 64, float_buffer=True)
    next(node for node in empty.world.node_tree.nodes if node.type == "TEX_ENVIRONMENT").image = users
    light()
    assert image_of(empty.world) != users and not pixels_of(users).any()
    count = len(bpy.data.images)
    light()
    assert len(bpy.data.images) == count, "the former one is gone"


def test_undo_brings_the_former_light_back(empty, capture):
    light()
    before = pixels_of(image_of(empty.world)).copy()
    bpy.ops.ed.undo_push(message="lit")
    empty.frame_set(8)
    light()
    bpy.ops.ed.undo_push(message="lit again")
    changed = pixels_of(image_of(bpy.context.scene.world)).copy()
    assert np.abs(changed - before).max() > 0.01
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(pixels_of(image_of(bpy.context.scene.world)), before)


@pytest.mark.parametrize("is_changed", [False, True])
def test_what_was_changed_in_a_lit_world_is_kept(empty, capture, is_changed):
    users_scene(empty)
    light()
    lit = empty.world
    if is_changed:
        node = next(node for node in lit.node_tree.nodes if node.type == "BACKGROUND" and node.label != "FRoG Light")
        node.inputs["Strength"].default_value = 3.0
    bpy.ops.frog.use_own_world()
    assert lit.use_fake_user == is_changed
