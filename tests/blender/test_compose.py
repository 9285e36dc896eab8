"""Captures among other objects: what hides what, and both engines' images in one."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from support import composed_scene
from support.small_scenes import passes_of, rig_of_three

from frog_blender import point_cloud
from frog_blender.engine.native.options import RasterizeOptions
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.lighting import world as lighting
from frog_blender.scene_import import scene_setup


def import_scene(path):
    assert bpy.ops.import_scene.frog(filepath=str(path)) == {"FINISHED"}
    return next(obj for obj in bpy.context.scene.objects if obj.frog.filepath)


def card(scene, place, size=20.0, color=(0.9, 0.1, 0.8)):
    return composed_scene.card(scene.collection, place, size, color)


def test_splats_end_where_an_object_hides_them(empty, static_rig, tmp_path):
    """A card across the middle of the figure: nothing behind it, everything before it."""
    import_scene(static_rig)
    place = card(empty, (0.0, 0.0, 0.0))
    empty.frog.hold_out = True
    empty.render.film_transparent = True
    combined, _ = passes_of(empty, tmp_path)
    camera = rig_of_three()[0]
    gaussians = ScenePlayer.load(static_rig).at_frame(0.0)
    y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
    limit = -camera.center[1] / rays[..., 1]  # planar depth at y = 0
    expected = draw(gaussians, camera, depth_limit=limit.astype(np.float32))
    np.testing.assert_allclose(combined[..., 3], expected.alpha, atol=2e-3)
    whole = draw(gaussians, camera, options=RasterizeOptions())
    assert (whole.alpha - expected.alpha).max() > 0.3, "the card hides something"
    assert expected.alpha.max() > 0.3, "and not all"
    place.hide_render = True
    np.testing.assert_allclose(passes_of(empty, tmp_path)[0][..., 3], whole.alpha, atol=2e-3)
    place.hide_render = False
    empty.frog.hold_out = False
    np.testing.assert_allclose(passes_of(empty, tmp_path)[0][..., 3], whole.alpha, atol=2e-3)


@pytest.mark.parametrize("motion_blur", [False, True])
def test_f12_puts_cycles_and_frog_together(empty, static_rig, tmp_path, rendered, motion_blur):
    obj = import_scene(static_rig)
    card(empty, (0.0, 0.0, 0.0))
    assert bpy.ops.frog.compose(engine="CYCLES", light=False) == {"FINISHED"}
    assert empty.render.engine == "CYCLES"
    splats = bpy.data.scenes[f"{empty.name} FRoG"]
    assert splats.render.engine == "FROG" and splats.render.film_transparent and splats.frog.hold_out
    empty.cycles.samples, empty.cycles.use_denoising = 1, False
    pixels = rendered(empty, use_motion_blur=False).astype(float) / 255
    camera, gaussians = rig_of_three()[0], ScenePlayer.load(static_rig).at_frame(0.0)
    y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
    limit = -camera.center[1] / rays[..., 1]
    drawing = draw(gaussians, camera, depth_limit=limit.astype(np.float32))
    from frog_blender.color_spaces import to_display, to_linear

    straight = to_linear(np.clip(drawing.rgb / np.maximum(drawing.alpha, 1e-6)[..., None], 0, 1))
    alpha = drawing.alpha[..., None]
    light = straight * alpha + np.array([0.9, 0.1, 0.8]) * (1 - alpha)
    assert np.abs(pixels[..., :3] - to_display(light).clip(0, 1)).max() < 3 / 255
    assert drawing.alpha.max() > 0.5 > drawing.alpha.min()
    assert not point_cloud.is_drawn_in_renders(obj)


def test_objects_are_lit_by_the_capture_where_nobody_made_a_world(empty, static_rig):
    """A cube in the grey of a new file, or in the black that a capture was filmed in, would be black among splats."""
    import_scene(static_rig)
    start = empty.world = world_of("World", (0.0509, 0.0509, 0.0509))
    assert bpy.ops.frog.compose() == {"FINISHED"}
    assert lighting.is_lit(empty) and empty.frog.own_world == start
    assert bpy.ops.frog.use_own_world() == {"FINISHED"}
    assert empty.world == start
    scene_setup.set_background(empty, np.zeros(3))
    background = empty.world
    assert bpy.ops.frog.compose(light=False) == {"FINISHED"} and empty.world == background
    assert bpy.ops.frog.compose() == {"FINISHED"} and lighting.is_lit(empty)


@pytest.mark.parametrize("name, color", [("World", (0.2, 0.3, 0.4)), ("Studio", (0.0509, 0.0509, 0.0509))])
def test_a_world_that_somebody_made_stays(empty, static_rig, name, color):
    import_scene(static_rig)
    own = empty.world = world_of(name, color)
    assert bpy.ops.frog.compose() == {"FINISHED"}
    assert empty.world == own and not lighting.is_lit(empty)


def world_of(name, color):
    world = bpy.data.worlds.new(name)
    world.use_nodes = True
    world.color = color
    next(node for node in world.node_tree.nodes if node.type == "BACKGROUND").inputs["Color"].default_value = (
        *color,
        1,
    )
    return world


def test_run_again_it_follows_the_scene(empty, static_rig):
    import_scene(static_rig)
    bpy.ops.frog.compose(light=False)
    splats = bpy.data.scenes[f"{empty.name} FRoG"]
    late = bpy.data.collections.new("late")
    empty.collection.children.link(late)
    empty.render.resolution_x = 123
    assert bpy.ops.frog.compose(light=False) == {"FINISHED"}
    assert len(bpy.data.scenes) == 2
    assert late in set(splats.collection.children) and splats.render.resolution_x == 123
    tree = getattr(empty, "compositing_node_group", None) or empty.node_tree
    assert sum(node.type == "ALPHAOVER" for node in tree.nodes) == 1


def read_by(scene):
    """The scene that the compositor lays over this one, as far as its links reach."""
    tree = getattr(scene, "compositing_node_group", None) or scene.node_tree
    (over,) = (node for node in tree.nodes if node.type == "ALPHAOVER")
    above = [socket for socket in over.inputs if socket.type == "RGBA"][1]
    (link,) = above.links
    assert link.from_socket.name == "Image" and link.from_socket.enabled and link.from_node.type == "R_LAYERS"
    return link.from_node.scene


def test_run_again_in_a_renamed_scene_it_keeps_its_splats(empty, static_rig):
    import_scene(static_rig)
    bpy.ops.frog.compose(light=False)
    splats = read_by(empty)
    empty.name = "Shot"
    empty.render.resolution_x = 123
    assert bpy.ops.frog.compose(light=False) == {"FINISHED"}
    assert len(bpy.data.scenes) == 2 and read_by(empty) == splats and splats.render.resolution_x == 123


def test_run_again_after_its_splats_were_deleted_it_shows_new_ones(empty, static_rig, rendered):
    import_scene(static_rig)
    bpy.ops.frog.compose(light=False)
    empty.cycles.samples, empty.cycles.use_denoising = 1, False
    before = rendered(empty)
    assert before[..., :3].std() > 10
    bpy.data.scenes.remove(read_by(empty))
    assert bpy.ops.frog.compose(light=False) == {"FINISHED"}
    assert read_by(empty).render.engine == "FROG" and len(bpy.data.scenes) == 2
    np.testing.assert_array_equal(rendered(empty), before)


def test_run_again_it_leaves_what_was_put_before_the_splats(empty, static_rig):
    import_scene(static_rig)
    bpy.ops.frog.compose(light=False)
    tree = getattr(empty, "compositing_node_group", None) or empty.node_tree
    splats = read_by(empty)
    (over,) = (node for node in tree.nodes if node.type == "ALPHAOVER")
    above = [socket for socket in over.inputs if socket.type == "RGBA"][1]
    layers, blur = above.links[0].from_node, tree.nodes.new("CompositorNodeBlur")
    tree.links.new(layers.outputs["Image"], blur.inputs["Image"])
    tree.links.new(blur.outputs[0], above)
    bpy.data.scenes.remove(splats)
    assert bpy.ops.frog.compose(light=False) == {"FINISHED"}
    assert above.links[0].from_node == blur and layers.scene.render.engine == "FROG"
    tree.nodes.remove(layers)
    assert bpy.ops.frog.compose(light=False) == {"FINISHED"}
    assert read_by(empty).render.engine == "FROG" and len(bpy.data.scenes) == 2


def test_what_the_compositor_did_before_stays(empty, static_rig):
    from frog_blender.render.compositing.compositor import own_tree

    import_scene(static_rig)
    tree, output = own_tree(empty)
    layers = tree.nodes.new("CompositorNodeRLayers")
    mine = tree.nodes.new("CompositorNodeBlur")
    tree.links.new(layers.outputs["Image"], mine.inputs["Image"])
    tree.links.new(mine.outputs[0], output.inputs["Image"])
    bpy.ops.frog.compose(light=False)
    over = output.inputs["Image"].links[0].from_node
    assert over.type == "ALPHAOVER"
    assert mine in {link.from_node for socket in over.inputs for link in socket.links}


def test_it_needs_a_capture(empty):
    assert not bpy.ops.frog.compose.poll()


def test_the_splats_scene_switches_cameras_and_leaves_out_what_the_users_does(empty, static_rig):
    import_scene(static_rig)
    hidden = bpy.data.collections.new("hidden")
    empty.collection.children.link(hidden)
    layer = empty.view_layers[0].layer_collection
    cameras = [obj for obj in empty.objects if obj.type == "CAMERA"][:2]
    for frame, camera in zip((1, 5), cameras, strict=True):
        empty.timeline_markers.new(camera.name, frame=frame).camera = camera
    empty.timeline_markers.new("a note", frame=3)
    for excluded in (True, False):
        layer.children["hidden"].exclude = excluded
        assert bpy.ops.frog.compose(engine="CYCLES", light=False) == {"FINISHED"}
        splats = bpy.data.scenes[f"{empty.name} FRoG"]
        found = [(marker.frame, marker.camera) for marker in splats.timeline_markers]
        assert found == list(zip((1, 5), cameras, strict=True))
        assert splats.view_layers[0].layer_collection.children["hidden"].exclude == excluded


@pytest.mark.parametrize("how", ["shadow catcher", "indirect only", "not for cameras"])
def test_what_cameras_do_not_see_hides_no_splats(empty, static_rig, tmp_path, how):
    import_scene(static_rig)
    empty.frog.hold_out = empty.render.film_transparent = True
    whole, _ = passes_of(empty, tmp_path)
    place = card(empty, (0.0, 0.0, 0.0))
    hidden, _ = passes_of(empty, tmp_path)
    assert np.abs(whole - hidden).max() > 0.3
    if how == "shadow catcher":
        place.is_shadow_catcher = True
    elif how == "not for cameras":
        place.visible_camera = False
    else:
        collection = bpy.data.collections.new("light")
        empty.collection.children.link(collection)
        empty.collection.objects.unlink(place)
        collection.objects.link(place)
        bpy.context.view_layer.layer_collection.children["light"].indirect_only = True
    np.testing.assert_array_equal(passes_of(empty, tmp_path)[0], whole)


@pytest.mark.parametrize("how", ["indirect only", "not for cameras", "scaled to nothing"])
def test_captures_that_cameras_do_not_see(empty, static_rig, tmp_path, how):
    obj = import_scene(static_rig)
    other = obj.copy()
    empty.collection.objects.link(other)  # which is no reason to lose the whole image
    other.parent = None
    empty.render.film_transparent = True
    assert passes_of(empty, tmp_path)[0][..., 3].max() > 0.5
    for each in (obj, other):
        if how == "not for cameras":
            each.visible_camera = False
        elif how == "scaled to nothing":
            each.scale = (0.0, 0.0, 0.0)
    if how == "indirect only":
        layer = bpy.context.view_layer.layer_collection
        layer.children[0].indirect_only = True
        other.hide_render = True
    assert not passes_of(empty, tmp_path)[0].any()
