"""After Render With My Objects: whatever a user changes is followed by the next render, or stops it with a sentence."""

from __future__ import annotations

import threading
from contextlib import nullcontext

import bpy
import numpy as np
import pytest
from scenes import glowing, read_png, rig_of_three, write_scene

from frog_blender import carrier, composed_checks, composed_renders, compositor, playback


def card(collection, place, size=0.4, color=(0.9, 0.1, 0.8)):
    """A glowing square in the plane x, z."""
    mesh = bpy.data.meshes.new("card")
    corners = [(-size, 0, -size), (size, 0, -size), (size, 0, size), (-size, 0, size)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    obj = bpy.data.objects.new("card", mesh)
    obj.location = place
    mesh.materials.append(glowing(color))
    collection.objects.link(obj)
    return obj


def collection_in(parent, name):
    made = bpy.data.collections.new(name)
    parent.children.link(made)
    return made


def compose(scene):
    assert bpy.ops.frog.compose(engine="CYCLES") == {"FINISHED"}
    scene.cycles.samples, scene.cycles.use_denoising = 1, False


@pytest.fixture
def composed(empty, static_rig):
    """A scene of a capture and two cards, one of them in a collection, after the button was pressed."""
    assert bpy.ops.import_scene.frog(filepath=str(static_rig)) == {"FINISHED"}
    card(empty.collection, (0.4, 0.0, 0.0))
    card(collection_in(empty.collection, "props"), (-0.5, 0.1, 0.2), color=(0.1, 0.8, 0.2))
    compose(empty)
    return empty


def compose_anew(scene):
    """As if the button had not been pressed before."""
    for other in list(bpy.data.scenes):
        if other.frog.composed_with is not None:
            bpy.data.scenes.remove(other)
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = None
    else:
        scene.node_tree.nodes.clear()
        scene.use_nodes = False
    compose(scene)


def the_capture():
    return next(playback.captures(bpy.data.objects))


def splats_of(scene):
    (found,) = (other for other in bpy.data.scenes if other.frog.composed_with == scene)
    return found


def cameras(scene):
    return sorted((obj for obj in scene.objects if obj.type == "CAMERA"), key=lambda obj: obj.name)


def nodes_of(scene, kind):
    return [node for node in compositor.tree_of(scene).nodes if node.type == kind]


# ------------------------------------------------------------------------------------------------ what is followed


def another_camera(scene):
    scene.camera = cameras(scene)[2]


def a_camera_bound_to_a_marker(scene):
    scene.timeline_markers.new("cut", frame=1).camera = cameras(scene)[2]


def a_new_camera(scene):
    scene.camera = cameras(scene)[0].copy()
    scene.camera.location.z += 0.3
    scene.collection.objects.link(scene.camera)


def a_camera_that_is_not_rendered(scene):
    hidden = collection_in(scene.collection, "cameras")
    scene.camera = cameras(scene)[2].copy()
    hidden.objects.link(scene.camera)
    scene.view_layers[0].layer_collection.children["cameras"].exclude = True


def a_region(scene):
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.2, 0.7
    scene.render.border_min_y, scene.render.border_max_y = 0.1, 0.9


def a_cropped_region(scene):
    a_region(scene)
    scene.render.use_crop_to_border = True


def no_region_after_one(scene):
    a_region(scene)
    compose(scene)
    bpy.ops.render.render()
    scene.render.use_border = False
    scene.render.resolution_x = 80


def another_resolution(scene):
    scene.render.resolution_x, scene.render.resolution_y = 72, 80


def half_size(scene):
    scene.render.resolution_percentage = 50


def oblong_pixels(scene):
    scene.render.pixel_aspect_y = 1.5


def another_frame(scene):
    scene.frame_set(7)


def between_frames(scene):
    scene.frame_set(3, subframe=0.5)


def stretched_time(scene):
    scene.render.frame_map_old, scene.render.frame_map_new = 100, 25
    scene.frame_set(8)


def motion_blur(scene):
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 3.0


def an_object_added(scene):
    card(scene.collection, (0.0, -0.6, -0.3), color=(0.2, 0.3, 0.9))


def collections_added(scene):
    inner = collection_in(collection_in(scene.collection, "outer"), "inner")
    card(inner, (0.0, -0.6, -0.3), color=(0.2, 0.3, 0.9))


def an_instance_added(scene):
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", bpy.data.collections["props"]
    instance.location = (0.6, -0.8, -0.2)
    scene.collection.objects.link(instance)


def a_collection_removed(scene):
    scene.collection.children.unlink(bpy.data.collections["props"])


def a_collection_excluded(scene):
    scene.view_layers[0].layer_collection.children["props"].exclude = True


def a_collection_held_out(scene):
    scene.render.film_transparent = True
    scene.view_layers[0].layer_collection.children["props"].holdout = True


def an_object_deleted(scene):
    bpy.data.objects.remove(bpy.data.objects["card"])


def an_object_hidden(scene):
    bpy.data.objects["card"].hide_render = True


def an_object_moved(scene):
    bpy.data.objects["card"].location.y = -1.0


def a_simplified_scene(scene):
    obj = bpy.data.objects["card"]
    obj.modifiers.new("round", "SUBSURF").render_levels = 3
    scene.render.use_simplify, scene.render.simplify_subdivision_render = True, 0
    obj.scale = (1.7, 1.0, 1.7)


def another_view_layer(scene):
    scene.view_layers[0].use = False
    scene.view_layers.new("mine").layer_collection.children["props"].exclude = True
    for node in nodes_of(scene, "R_LAYERS"):
        if node.scene == scene:
            node.layer = "mine"


def another_world(scene):
    scene.world = bpy.data.worlds.new("bright")
    scene.world.color = (0.3, 0.5, 0.7)
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    nodes = [node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND"]
    for node in nodes:
        node.inputs["Color"].default_value = (0.3, 0.5, 0.7, 1.0)


def a_transparent_film(scene):
    scene.render.film_transparent = True


def another_view_transform(scene):
    scene.view_settings.view_transform = "AgX"


def another_exposure(scene):
    scene.view_settings.exposure = 1.0


def a_capture_added(scene):
    other = the_capture().copy()
    other.parent = None
    other.location.x += 0.8
    scene.collection.objects.link(other)


def a_capture_moved_to_another_collection(scene):
    obj = the_capture()
    (before,) = obj.users_collection
    bpy.data.collections["props"].objects.link(obj)
    before.objects.unlink(obj)
    an_object_moved(scene)


def a_capture_turned(scene):
    the_capture().rotation_euler.z += 1.0


def points_switched_on(scene):
    """Which the other engine would draw, and FRoG once more."""
    carrier.draw_in_renders(the_capture(), True)
    an_object_moved(scene)


def captures_hidden(scene):
    the_capture().hide_render = True


def captures_deleted(scene):
    bpy.data.objects.remove(the_capture())


def renamed_scenes(scene):
    splats_of(scene).name = "Whatever"
    scene.name = "Shot 7"
    another_camera(scene)


def the_splats_scene_tampered_with(scene):
    splats = splats_of(scene)
    splats.render.engine, splats.render.film_transparent = "CYCLES", False
    splats.render.use_border, splats.render.border_max_x, splats.render.resolution_x = True, 0.3, 20
    splats.camera, splats.view_layers[0].use = None, False
    another_frame(scene)


def undone(scene):
    bpy.ops.ed.undo_push(message="before")
    card(scene.collection, (0.0, -0.6, -0.3))
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="a card")
    bpy.ops.ed.undo()
    another_camera(bpy.context.scene)


FOLLOWED = [
    *(another_camera, a_camera_bound_to_a_marker, a_new_camera, a_camera_that_is_not_rendered),
    *(a_region, a_cropped_region, no_region_after_one, another_resolution, half_size, oblong_pixels),
    *(another_frame, between_frames, stretched_time, motion_blur),
    *(an_object_added, collections_added, an_instance_added, a_collection_removed, a_collection_excluded),
    *(a_collection_held_out, an_object_deleted, an_object_hidden, an_object_moved, a_simplified_scene),
    *(another_view_layer, another_world, a_transparent_film, another_view_transform, another_exposure),
    *(
        a_capture_added,
        a_capture_moved_to_another_collection,
        a_capture_turned,
        points_switched_on,
        captures_hidden,
        captures_deleted,
    ),
    *(renamed_scenes, the_splats_scene_tampered_with, undone),
]


def name_of(change):
    return change.__name__


@pytest.fixture
def in_a_window(monkeypatch):
    """A function after which renders run as they do in a window, as if in a thread that must not change the scene."""

    def begin():
        for module in (composed_checks, composed_renders):
            monkeypatch.setattr(module, "is_main_thread", lambda: False)

    return begin


@pytest.mark.parametrize("window", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["script", "window"])
@pytest.mark.parametrize("change", FOLLOWED, ids=name_of)
def test_it_is_followed(composed, rendered, change, window, in_a_window):
    if window:
        in_a_window()
    before = rendered(composed)
    change(composed)
    scene = bpy.context.scene  # which undo makes anew
    found = rendered(scene)
    assert not composed_renders._to_say or change in (captures_hidden, captures_deleted)
    assert found.shape != before.shape or (found != before).any(), "the change shows"
    if change is captures_deleted:
        assert not next(playback.captures(bpy.data.objects), None)
        the_node_muted(scene)  # what the objects alone look like
    else:
        compose_anew(scene)
    np.testing.assert_array_equal(found, rendered(scene))


def the_node_muted(scene):
    (over,) = nodes_of(scene, "ALPHAOVER")
    over.mute = True


def the_node_unlinked(scene):
    (over,) = nodes_of(scene, "ALPHAOVER")
    target = over.outputs[0].links[0].to_socket
    (own,) = (node for node in nodes_of(scene, "R_LAYERS") if node.scene == scene)
    compositor.tree_of(scene).links.new(own.outputs["Image"], target)


def compositing_switched_off(scene):
    scene.render.use_compositing = False


def the_splats_scene_deleted(scene):
    bpy.data.scenes.remove(splats_of(scene))


def the_nodes_deleted(scene):
    compositor.tree_of(scene).nodes.clear()
    scene.render.use_compositing = False


@pytest.mark.parametrize(
    "change",
    [the_node_muted, the_node_unlinked, compositing_switched_off, the_splats_scene_deleted, the_nodes_deleted],
    ids=name_of,
)
def test_captures_that_frog_no_longer_draws_are_drawn_by_the_other_engine(empty, static_rig, rendered, change):
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    card(empty.collection, (0.4, 0.0, 0.0))
    empty.render.engine, empty.cycles.samples, empty.cycles.use_denoising = "CYCLES", 1, False
    before = rendered(empty)
    compose(empty)
    both = rendered(empty)
    assert (both != before).any() and not carrier.is_drawn_in_renders(the_capture())
    change(empty)
    np.testing.assert_array_equal(rendered(empty), before)
    compose(empty)
    np.testing.assert_array_equal(rendered(empty), both)


# ------------------------------------------------------------------------------------------------- what is refused


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
    scene.camera.data.type = "PANO"
    return "expected a perspective"


def frog_for_both(scene):
    scene.render.engine = "FROG"
    return "is rendered by FRoG"


def a_single_layer(scene):
    scene.render.use_single_layer = True
    return "renders a single layer"


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
    sockets = [[socket for socket in each.inputs if socket.type == "RGBA"] for each in (over, inside[over])]
    for mine, theirs in zip(*sockets, strict=True):
        group.links.new(inside[mine.links[0].from_node].outputs["Image"], theirs)
    group.links.new(inside[over].outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    target = over.outputs[0].links[0].to_socket
    outer = tree.nodes.new("CompositorNodeGroup")
    outer.node_tree = group
    tree.links.new(outer.outputs[0], target)
    for node in inside:
        tree.nodes.remove(node)
    return "from within a group of nodes"


def a_simulation(scene):
    bpy.ops.rigidbody.world_add()
    scene.rigidbody_world.collection = bpy.data.collections.new("bodies")
    scene.rigidbody_world.collection.objects.link(bpy.data.objects["card"])
    return "is moved by a simulation"


REFUSED = [
    *(a_file_gone, a_file_spoiled, an_uneven_scale, a_fisheye, frog_for_both, a_single_layer),
    *(the_nodes_grouped, a_simulation),
]


@pytest.mark.parametrize("animation", [False, True], ids=["still", "animation"])
@pytest.mark.parametrize(
    "change",
    REFUSED,
    ids=name_of,
)
def test_it_is_refused_in_a_sentence(composed, tmp_path, rendered, change, animation):
    rendered(composed)
    sentence = change(composed)
    bpy.context.view_layer.update()
    before = [getattr(composed.render, name) for name in ("engine", "use_compositing", "use_sequencer")]
    composed.frame_end = 2
    out = tmp_path / "out"
    composed.render.filepath = str(out / "frame")
    with pytest.raises(RuntimeError, match=sentence):
        bpy.ops.render.render(write_still=not animation, animation=animation)
    assert [getattr(composed.render, name) for name in ("engine", "use_compositing", "use_sequencer")] == before
    assert composed.frame_current == 1
    assert not list(out.glob("*.png"))


@pytest.mark.parametrize("kind", ["LINK_COPY", "FULL_COPY"])
def test_a_copied_scene_is_refused_until_it_is_composed_itself(composed, rendered, kind):
    before = rendered(composed)
    assert bpy.ops.scene.new(type=kind) == {"FINISHED"}
    copy = bpy.context.scene
    assert copy != composed
    copy.camera = cameras(copy)[2]
    with pytest.raises(RuntimeError, match=f"run Render With My Objects in {copy.name}"):
        bpy.ops.render.render(scene=copy.name)
    compose(copy)
    assert (rendered(copy) != before).any()
    np.testing.assert_array_equal(rendered(composed), before)


def test_scenes_that_share_their_nodes_each_have_their_own_afterwards(composed, rendered):
    if not hasattr(composed, "compositing_node_group"):
        pytest.skip("before 5.0 a scene has its nodes to itself")
    before = rendered(composed)
    assert bpy.ops.scene.new(type="LINK_COPY") == {"FINISHED"}
    copy = bpy.context.scene
    copy.compositing_node_group = composed.compositing_node_group
    copy.camera = cameras(copy)[2]
    compose(copy)
    assert (rendered(copy) != before).any()
    np.testing.assert_array_equal(rendered(composed), before)


# --------------------------------------------------------------------------------- what nobody could know beforehand


def is_striped(picture):
    """Whether a picture is the pattern that says that there is none."""
    magenta = (picture[..., :3] == (255, 0, 255)).all(-1)
    black = (picture[..., :3] == 0).all(-1)
    return (magenta | black).all() and 0.3 < magenta.mean() < 0.7


REFUSED_IN_WINDOWS = [a_file_gone, a_file_spoiled, an_uneven_scale, a_fisheye, frog_for_both, a_simulation]


@pytest.mark.parametrize("change", REFUSED_IN_WINDOWS, ids=name_of)
def test_in_a_window_what_is_refused_is_no_picture_and_ends_the_animation(
    composed, tmp_path, change, in_a_window, capfd
):
    """Blender goes on there whatever a handler finds, unless FRoG is the engine of the scene itself."""
    in_a_window()
    sentence = change(composed)
    bpy.context.view_layer.update()
    composed.frame_end = 4
    composed.render.image_settings.file_format = "PNG"
    composed.render.filepath = str(tmp_path / "out_")
    stops = change is frog_for_both
    with pytest.raises(RuntimeError, match=sentence) if stops else nullcontext():
        bpy.ops.render.render(animation=True)
    pictures = [read_png(path) for path in sorted(tmp_path.glob("out_*.png"))]
    assert [is_striped(picture) for picture in pictures] == ([] if stops else [True])
    assert composed.frame_current == 1 and sentence in "".join(capfd.readouterr())


def test_in_a_window_a_copied_scene_is_refused(composed, rendered, in_a_window):
    bpy.ops.scene.new(type="LINK_COPY")
    in_a_window()
    assert is_striped(rendered(bpy.context.scene))


@pytest.mark.parametrize("error", [MemoryError(), ValueError("a fault of our own")], ids=["memory", "a bug"])
def test_what_fails_later_is_no_picture_and_ends_the_animation(composed, tmp_path, monkeypatch, capsys, error):
    from frog_blender import render_engine

    drawn = []

    def gather(depsgraph):
        drawn.append(depsgraph.scene.frame_current)
        if drawn[-1] == 2:
            raise error
        return gathered(depsgraph)

    gathered = render_engine.gather
    monkeypatch.setattr(render_engine, "gather", gather)
    composed.frame_end = 5
    composed.render.image_settings.file_format = "PNG"
    composed.render.filepath = str(tmp_path / "out_")
    bpy.ops.render.render(animation=True)
    assert drawn == [1, 2] and composed.frame_current == 1
    pictures = [read_png(path) for path in sorted(tmp_path.glob("out_*.png"))]
    assert [is_striped(picture) for picture in pictures] == [False, True]
    said = "Out of memory" if isinstance(error, MemoryError) else "a fault of our own"
    assert said in capsys.readouterr().err


def test_a_still_that_fails_leaves_the_scene_as_it_was(composed, monkeypatch, rendered):
    from frog_blender import render_engine

    before = rendered(composed)
    composed.frame_set(4)
    with monkeypatch.context() as patch:
        patch.setattr(render_engine, "gather", lambda depsgraph: (_ for _ in ()).throw(MemoryError()))
        assert is_striped(rendered(composed))
    assert composed.frame_current == 4 and composed.render.engine == "CYCLES"
    composed.frame_set(1)
    np.testing.assert_array_equal(rendered(composed), before)


def test_it_says_that_a_layer_rendered_alone_lacks_the_captures(composed, capsys):
    bpy.ops.render.render(layer=composed.view_layers[0].name)
    assert "the picture lacks the captures" in capsys.readouterr().err


def test_it_says_once_that_no_capture_is_seen(composed, tmp_path, capsys):
    the_capture().hide_render = True
    composed.frame_end = 3
    composed.render.filepath = str(tmp_path / "out_")
    bpy.ops.render.render(animation=True)
    assert capsys.readouterr().err.count("no capture") == 1


# ------------------------------------------------------------------------------------------------------ further ones


def test_an_animation_follows_cameras_sizes_and_time(composed, rendered, tmp_path):
    """Its frames are those that stills have; the pictures' size stays the first one's."""
    for frame, camera in zip((1, 2), (cameras(composed)[0], cameras(composed)[2]), strict=True):
        composed.timeline_markers.new("cut", frame=frame).camera = camera
    composed.render.use_motion_blur = True
    for frame, shutter in ((1, 0.0), (2, 4.0)):
        composed.render.motion_blur_shutter = shutter
        composed.render.keyframe_insert("motion_blur_shutter", frame=frame)
    composed.frame_start, composed.frame_end = 1, 2
    composed.render.image_settings.file_format = "PNG"
    composed.render.filepath = str(tmp_path / "out_")
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    pictures = [read_png(path) for path in sorted(tmp_path.glob("out_*.png"))]
    assert len(pictures) == 2
    for frame, picture in enumerate(pictures, start=1):
        composed.frame_set(frame)
        compose_anew(composed)
        found = rendered(composed)
        np.testing.assert_array_equal(picture[..., :3], found[..., :3])


@pytest.fixture
def eyes(tmp_path):
    """A function that renders a scene in stereo: the pictures of the left and the right eye."""

    def render(scene):
        scene.render.use_multiview, scene.render.views_format = True, "STEREO_3D"
        scene.render.image_settings.file_format = "PNG"
        scene.render.image_settings.views_format = "INDIVIDUAL"
        scene.render.filepath = str(tmp_path / "stereo.png")
        assert bpy.ops.render.render(write_still=True, scene=scene.name) == {"FINISHED"}
        return [read_png(tmp_path / f"stereo_{eye}.png") for eye in "LR"]

    return render


def test_each_eye_has_its_own_splats(composed, eyes, rendered):
    camera = composed.camera
    stereo = camera.data.stereo
    left, right = eyes(composed)
    assert (left != right).any()
    stereo.convergence_mode, stereo.pivot = "PARALLEL", "CENTER"
    left, right = eyes(composed)
    composed.render.use_multiview = False
    place = camera.matrix_world.copy()
    for picture, sign in ((left, -0.5), (right, 0.5)):
        moved = place.copy()
        moved.translation += place.col[0].to_3d() * (sign * stereo.interocular_distance)
        camera.matrix_world = moved
        found = rendered(composed).astype(int)
        assert np.abs(found - picture).max() <= 2, "an eye is a camera that stands beside the other one"


def test_a_scene_of_another_engine_is_not_looked_at(empty, tmp_path):
    """Nothing of this is for scenes that were never composed, whatever their captures lack."""
    path = write_scene(tmp_path / "gone.frog", rig_of_three())
    bpy.ops.import_scene.frog(filepath=str(path))
    path.unlink()
    empty.render.engine = "CYCLES"
    assert composed_renders.trouble(empty) == ""


def test_other_threads_change_nothing(composed):
    """Where Blender renders in a thread of its own, what the scene lacks is a sentence, not a change."""
    card(composed.collection, (0.0, -0.6, -0.3))
    said = []
    thread = threading.Thread(target=lambda: said.append(composed_renders.trouble(composed)))
    thread.start()
    thread.join()
    assert "has other objects than" in said[0]
    bpy.context.view_layer.update()
    assert composed_renders.trouble(composed) == ""


def test_pictures_put_together_by_hand_have_the_region_of_the_scene_that_is_rendered(empty, static_rig, rendered):
    """FRoG's scene follows none, but Blender renders it by the other one's size and region all the same."""
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    compose(empty)
    whole = rendered(empty)
    splats_of(empty).frog.composed_with = None
    bpy.context.view_layer.update()
    carrier.draw_in_renders(the_capture(), False)
    a_region(empty)
    found = rendered(empty)
    height, width = whole.shape[:2]
    inside = (
        slice(round(0.1 * height) + 1, round(0.9 * height) - 1),
        slice(int(0.2 * width) + 1, int(0.7 * width) - 1),
    )
    np.testing.assert_array_equal(found[inside], whole[inside])
    assert found[inside][..., :3].std() > 10
