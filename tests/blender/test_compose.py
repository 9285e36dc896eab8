"""Captures among other objects: what hides what, and both engines' images in one."""

import bpy
import numpy as np
import pytest
from support import composed_scene
from support.small_scenes import passes_of, rig_of_three, world_of

from frog_blender import point_cloud
from frog_blender.color_spaces import to_display
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.srgb import to_linear
from frog_blender.lighting import world as lighting
from frog_blender.render.compositing import compositor
from frog_blender.scene_import import scene_setup


def card(scene):
    """Across the middle of everything."""
    return composed_scene.card(scene.collection, (0.0, 0.0, 0.0), 20.0)


def up_to_the_card(path):
    """What the engine draws of a capture before the card, and of all of it."""
    camera, gaussians = rig_of_three()[0], ScenePlayer.load(path).at_frame(0.0)
    y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
    limit = -camera.center[1] / rays[..., 1]  # planar depth at y = 0
    return draw(gaussians, camera, depth_limit=limit.astype(np.float32)), draw(gaussians, camera)


def test_splats_end_where_an_object_hides_them(empty, capture, static_rig, tmp_path):
    """A card across the middle of the figure: nothing behind it, everything before it."""
    place = card(empty)
    empty.frog.hold_out = empty.render.film_transparent = True
    expected, whole = up_to_the_card(static_rig)
    np.testing.assert_allclose(passes_of(empty, tmp_path)[0][..., 3], expected.alpha, atol=2e-3)
    assert (whole.alpha - expected.alpha).max() > 0.3, "the card hides something"
    assert expected.alpha.max() > 0.3, "and not all"
    place.hide_render = True
    np.testing.assert_allclose(passes_of(empty, tmp_path)[0][..., 3], whole.alpha, atol=2e-3)
    place.hide_render = empty.frog.hold_out = False
    np.testing.assert_allclose(passes_of(empty, tmp_path)[0][..., 3], whole.alpha, atol=2e-3)


def test_f12_puts_cycles_and_frog_together(empty, capture, static_rig, rendered):
    card(empty)
    composed_scene.compose(empty)
    splats = bpy.data.scenes[f"{empty.name} FRoG"]
    assert empty.render.engine == "CYCLES" and splats.render.engine == "FROG"
    assert splats.render.film_transparent and splats.frog.hold_out
    pixels = rendered(empty).astype(float) / 255
    drawing, _ = up_to_the_card(static_rig)
    alpha = drawing.alpha[..., None]
    straight = to_linear(np.clip(drawing.rgb / np.maximum(alpha, 1e-6), 0, 1))
    light = straight * alpha + np.array([0.9, 0.1, 0.8]) * (1 - alpha)
    assert np.abs(pixels[..., :3] - to_display(light).clip(0, 1)).max() < 3 / 255
    assert drawing.alpha.max() > 0.5 > drawing.alpha.min()
    assert not point_cloud.is_drawn_in("render", capture)


def test_objects_are_lit_by_the_capture_where_nobody_made_a_world(empty, capture):
    """A cube in the grey of a new file, or in the black that a capture was filmed in, would be black among splats."""
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
def test_a_world_that_somebody_made_stays(empty, capture, name, color):
    own = empty.world = world_of(name, color)
    assert bpy.ops.frog.compose() == {"FINISHED"}
    assert empty.world == own and not lighting.is_lit(empty)


def above(scene):
    """The socket of what the compositor lays over a scene."""
    (over,) = composed_scene.nodes_of(scene, "ALPHAOVER")
    return [socket for socket in over.inputs if socket.type == "RGBA"][1]


def read_by(scene):
    """The scene that the compositor lays over this one, as far as its links reach."""
    (link,) = above(scene).links
    assert link.from_socket.name == "Image" and link.from_socket.enabled and link.from_node.type == "R_LAYERS"
    return link.from_node.scene


def test_run_again_after_its_splats_were_deleted_it_shows_new_ones(empty, capture, rendered):
    composed_scene.compose(empty)
    before = rendered(empty)
    assert before[..., :3].std() > 10
    bpy.data.scenes.remove(read_by(empty))
    composed_scene.compose(empty)
    assert read_by(empty).render.engine == "FROG" and len(bpy.data.scenes) == 2
    np.testing.assert_array_equal(rendered(empty), before)


def test_run_again_it_leaves_what_was_put_before_the_splats(empty, capture):
    composed_scene.compose(empty)
    tree, splats = compositor.tree_of(empty), read_by(empty)
    socket = above(empty)
    layers, blur = socket.links[0].from_node, tree.nodes.new("CompositorNodeBlur")
    tree.links.new(layers.outputs["Image"], blur.inputs["Image"])
    tree.links.new(blur.outputs[0], socket)
    bpy.data.scenes.remove(splats)
    composed_scene.compose(empty)
    assert socket.links[0].from_node == blur and layers.scene.render.engine == "FROG"
    tree.nodes.remove(layers)
    composed_scene.compose(empty)
    assert read_by(empty).render.engine == "FROG" and len(bpy.data.scenes) == 2


def test_what_the_compositor_did_before_stays(empty, capture):
    tree, output = compositor.own_tree(empty)
    layers = tree.nodes.new("CompositorNodeRLayers")
    mine = tree.nodes.new("CompositorNodeBlur")
    tree.links.new(layers.outputs["Image"], mine.inputs["Image"])
    tree.links.new(mine.outputs[0], output.inputs["Image"])
    composed_scene.compose(empty)
    over = output.inputs["Image"].links[0].from_node
    assert over.type == "ALPHAOVER"
    assert mine in {link.from_node for socket in over.inputs for link in socket.links}


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="the output is a node with an Image")
@pytest.mark.parametrize("outputs", [(), ("Picture",), ("Depth", "Image"), ("Matte", "Image")])
def test_the_image_is_what_blender_shows_of_a_tree(empty, capture, rendered, outputs):
    composed_scene.compose(empty)
    expected = rendered(empty)
    tree = empty.compositing_node_group = bpy.data.node_groups.new("mine", "CompositorNodeTree")
    for name in outputs:
        kind = "NodeSocketFloat" if name == "Depth" else "NodeSocketColor"
        tree.interface.new_socket(name, in_out="OUTPUT", socket_type=kind)
    tree.nodes.new("NodeGroupOutput")
    composed_scene.compose(empty)
    np.testing.assert_array_equal(rendered(empty), expected)
    assert {*outputs} <= {item.name for item in tree.interface.items_tree} and len(bpy.data.scenes) == 2


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="scenes have nodes of their own")
def test_the_nodes_of_another_file_stay(empty, capture, tmp_path):
    tree = bpy.data.node_groups.new("theirs", "CompositorNodeTree")
    bpy.data.libraries.write(str(tmp_path / "theirs.blend"), {tree})
    bpy.data.node_groups.remove(tree)
    with bpy.data.libraries.load(str(tmp_path / "theirs.blend"), link=True) as (_, linked):
        linked.node_groups = ["theirs"]
    (tree,) = linked.node_groups
    empty.compositing_node_group = tree
    composed_scene.compose(empty)
    assert empty.compositing_node_group.library is None and not tree.nodes


def test_it_needs_a_capture(empty):
    assert not bpy.ops.frog.compose.poll()


def test_what_cameras_do_not_see_hides_no_splats(empty, capture, tmp_path):
    empty.frog.hold_out = empty.render.film_transparent = True
    whole, _ = passes_of(empty, tmp_path)
    inside = composed_scene.collection_in(empty.collection, "light")
    place = composed_scene.card(inside, (0.0, 0.0, 0.0), 20.0)
    layer = bpy.context.view_layer.layer_collection.children["light"]
    for owner, name, value in (
        *((place, "is_shadow_catcher", True), (place, "visible_camera", False)),
        (layer, "indirect_only", True),
    ):
        assert np.abs(whole - passes_of(empty, tmp_path)[0]).max() > 0.3
        setattr(owner, name, value)
        np.testing.assert_array_equal(passes_of(empty, tmp_path)[0], whole, err_msg=name)
        setattr(owner, name, not value)


def test_captures_that_cameras_do_not_see(empty, capture, tmp_path):
    empty.render.film_transparent = True
    layer = bpy.context.view_layer.layer_collection.children[0]
    for owner, name, value in (
        (layer, "indirect_only", True),
        (capture, "visible_camera", False),
        (capture, "scale", (0.0, 0.0, 0.0)),  # which is no reason to lose the whole image
    ):
        assert passes_of(empty, tmp_path)[0][..., 3].max() > 0.5
        before = getattr(owner, name) if name != "scale" else tuple(capture.scale)
        setattr(owner, name, value)
        assert not passes_of(empty, tmp_path)[0].any(), name
        setattr(owner, name, before)
