"""After Render With My Objects: what cannot be followed stops the render with a sentence, or is no image."""

import threading
from contextlib import nullcontext

import bpy
import numpy as np
import pytest
from support.builders import refuses
from support.composed_scene import cameras, card, compose, is_striped, name_of, nodes_of, the_capture
from support.observed_players import observed
from support.small_scenes import read_png

from frog_blender.render.compositing import compositor, renders
from frog_blender.timeline import playback


def a_file_gone(scene):
    playback.file_of(the_capture()).unlink()
    return "found no file"


def a_file_spoiled(scene):
    file = playback.file_of(the_capture())
    file.write_bytes(file.read_bytes()[:2000])
    return file.name


def an_uneven_scale(scene):
    the_capture().scale.z = 2.0
    return "scaled unevenly"


def a_fisheye(scene):
    scene.camera.data.type, scene.camera.data.panorama_type = "PANO", "FISHEYE_LENS_POLYNOMIAL"
    return "of the kind fisheye lens polynomial"


def frog_for_both(scene):
    scene.render.engine = "FROG"
    return "is rendered by FRoG"


def a_single_layer(scene):
    scene.render.use_single_layer = True
    return "renders a single layer"


def a_layer_unused(scene):
    scene.view_layers.new("mine")
    scene.view_layers[0].use = False
    return f"its view layer {scene.view_layers[0].name}, which is not rendered"


def the_nodes_grouped(scene):
    """As Ctrl-G does, into a group of their own."""
    if not hasattr(scene, "compositing_node_group"):
        pytest.skip("before 5.0 no group can have Render Layers")
    tree = compositor.tree_of(scene)
    (over,) = nodes_of(scene, "ALPHAOVER")
    group = bpy.data.node_groups.new("group", "CompositorNodeTree")
    group.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    inside = {}
    for node in (over, *nodes_of(scene, "R_LAYERS")):
        made = inside[node] = group.nodes.new(node.bl_idname)
        if node.type == "R_LAYERS":
            made.scene = node.scene
    sockets = [[socket for socket in node.inputs if socket.type == "RGBA"] for node in (over, inside[over])]
    for mine, theirs in zip(*sockets, strict=True):
        group.links.new(inside[mine.links[0].from_node].outputs["Image"], theirs)
    group.links.new(inside[over].outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    target = over.outputs[0].links[0].to_socket
    outer = tree.nodes.new("CompositorNodeGroup")
    outer.node_tree = group
    tree.links.new(outer.outputs[0], target)
    for node in inside:
        tree.nodes.remove(node)
    return "from within a node group"


def a_simulation(scene):
    bpy.ops.rigidbody.world_add()
    scene.rigidbody_world.collection = bpy.data.collections.new("bodies")
    scene.rigidbody_world.collection.objects.link(bpy.data.objects["card"])
    return "is moved by a simulation"


REFUSED = [
    *(a_file_gone, a_file_spoiled, an_uneven_scale, a_fisheye, frog_for_both, a_single_layer),
    *(the_nodes_grouped, a_simulation, a_layer_unused),
]


@pytest.fixture
def frames(composed, tmp_path):
    """A function that gives the images that a render has written until now."""
    composed.render.image_settings.file_format = "PNG"
    composed.render.filepath = str(tmp_path / "out_")
    return lambda: [read_png(path) for path in sorted(tmp_path.glob("out_*"))]


@pytest.mark.parametrize(("change", "animation"), [(change, index % 2) for index, change in enumerate(REFUSED)])
def test_it_is_refused_in_a_sentence(composed, rendered, frames, change, animation):
    """Stills and animations in turn: what is refused is found before either begins."""
    rendered(composed)
    sentence = change(composed)
    bpy.context.view_layer.update()
    before = [getattr(composed.render, name) for name in ("engine", "use_compositing", "use_sequencer")]
    composed.frame_end = 2
    refuses(sentence, bpy.ops.render.render, write_still=not animation, animation=bool(animation))
    assert [getattr(composed.render, name) for name in ("engine", "use_compositing", "use_sequencer")] == before
    assert composed.frame_current == 1 and not frames()


def test_a_copied_scene_is_refused_until_it_is_composed_itself(composed, rendered, in_a_window):
    before = rendered(composed)
    assert bpy.ops.scene.new(type="LINK_COPY") == {"FINISHED"}
    copy = bpy.context.scene
    assert copy != composed
    if hasattr(copy, "compositing_node_group"):  # before 5.0 a scene has its nodes to itself
        copy.compositing_node_group = composed.compositing_node_group
    copy.camera = cameras(copy)[2]
    refuses(f"Run Render With My Objects in {copy.name}", bpy.ops.render.render, scene=copy.name)
    compose(copy)
    assert (rendered(copy) != before).any()
    np.testing.assert_array_equal(rendered(composed), before)
    bpy.context.window.scene = composed
    bpy.ops.scene.new(type="LINK_COPY")
    in_a_window()
    assert is_striped(rendered(bpy.context.scene))


@pytest.mark.parametrize("change", [a_file_gone, an_uneven_scale, frog_for_both, a_simulation], ids=name_of)
def test_in_a_window_what_is_refused_is_no_image_and_ends_the_animation(composed, frames, change, in_a_window, capfd):
    """Blender goes on there whatever a handler finds, unless FRoG is the engine of the scene itself."""
    in_a_window()
    sentence, stops = change(composed), change is frog_for_both
    bpy.context.view_layer.update()
    composed.frame_end = 4
    with pytest.raises(RuntimeError, match=sentence) if stops else nullcontext():
        bpy.ops.render.render(animation=True)
    assert [is_striped(image) for image in frames()] == ([] if stops else [True])
    assert composed.frame_current == 1 and sentence in "".join(capfd.readouterr())


@pytest.mark.parametrize("error", [MemoryError(), ValueError("a fault of our own")], ids=repr)
def test_what_fails_later_is_no_image_and_ends_the_animation(composed, rendered, frames, capsys, error):
    drawn = []

    def giving(player, time):
        drawn.append(time)
        if time == player.time_of(1.0):  # which is shown at frame 2
            raise error

    composed.frame_end = 5
    with observed(giving=giving):
        bpy.ops.render.render(animation=True)
        assert len(drawn) == 2 and composed.frame_current == 1
        assert [is_striped(image) for image in frames()] == [False, True]
        said = "Out of memory" if isinstance(error, MemoryError) else "a fault of our own"
        assert said in capsys.readouterr().err and said in renders.problems()[0], "in the console and in the panel"
        composed.frame_set(2)
        assert is_striped(rendered(composed))
    assert composed.frame_current == 2 and composed.render.engine == "CYCLES", "a still leaves the scene as it was"
    assert not is_striped(rendered(composed)) and not renders.problems()


def test_it_says_that_a_layer_rendered_alone_lacks_the_captures(composed, capsys):
    bpy.ops.render.render(layer=composed.view_layers[0].name)
    assert "The captures are missing from the image" in capsys.readouterr().err


def test_it_says_once_that_no_capture_is_seen(composed, frames, capsys):
    the_capture().hide_render = True
    composed.frame_end = 3
    bpy.ops.render.render(animation=True)
    assert len(frames()) == 3 and capsys.readouterr().err.count("no capture") == 1


def test_other_threads_change_nothing(composed):
    """Where Blender renders in a thread of its own, what the scene lacks is a sentence, not a change."""
    card(composed.collection, (0.0, -0.6, -0.3))
    said = []
    thread = threading.Thread(target=lambda: said.append(renders.trouble(composed)))
    thread.start()
    thread.join()
    assert "does not have the same objects as" in said[0]
    bpy.context.view_layer.update()
    assert renders.trouble(composed) == ""
