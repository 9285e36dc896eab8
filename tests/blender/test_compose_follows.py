"""After Render With My Objects: whatever a user changes is followed by the next render."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from support.composed_scene import (
    a_region,
    cameras,
    card,
    collection_in,
    compose,
    compose_anew,
    name_of,
    nodes_of,
    splats_of,
    the_capture,
    the_node_muted,
)
from support.small_scenes import read_png

from frog_blender import point_cloud
from frog_blender.render.compositing import checks, compositor, renders
from frog_blender.timeline import playback


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
    point_cloud.draw_in_renders(the_capture(), True)
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


# One of each kind by default: each renders four times, and every other kind of change takes the same way.
OF_EACH_KIND = (another_camera, a_region, between_frames, an_object_added, another_view_layer, captures_deleted, undone)
CHANGES = [pytest.param(change, marks=[] if change in OF_EACH_KIND else pytest.mark.slow) for change in FOLLOWED]


@pytest.mark.parametrize("window", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["script", "window"])
@pytest.mark.parametrize("change", CHANGES, ids=name_of)
def test_it_is_followed(composed, rendered, change, window, in_a_window):
    if window:
        in_a_window()
    before = rendered(composed)
    change(composed)
    scene = bpy.context.scene  # which undo makes anew
    found = rendered(scene)
    assert not renders.problems() or change in (captures_hidden, captures_deleted)
    assert found.shape != before.shape or (found != before).any(), "the change shows"
    if change is captures_deleted:
        assert not next(playback.captures(bpy.data.objects), None)
        the_node_muted(scene)  # what the objects alone look like
    else:
        compose_anew(scene)
    np.testing.assert_array_equal(found, rendered(scene))


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


MORE_WAYS_TO_END = (the_node_muted, compositing_switched_off, the_nodes_deleted)


@pytest.mark.parametrize(
    "change",
    [
        the_node_unlinked,
        the_splats_scene_deleted,
        *(pytest.param(change, marks=pytest.mark.slow) for change in MORE_WAYS_TO_END),
    ],
    ids=name_of,
)
def test_captures_that_frog_no_longer_draws_are_drawn_by_the_other_engine(empty, static_rig, rendered, change):
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    card(empty.collection, (0.4, 0.0, 0.0))
    empty.render.engine, empty.cycles.samples, empty.cycles.use_denoising = "CYCLES", 1, False
    before = rendered(empty)
    compose(empty)
    both = rendered(empty)
    assert (both != before).any() and not point_cloud.is_drawn_in_renders(the_capture())
    change(empty)
    np.testing.assert_array_equal(rendered(empty), before)
    compose(empty)
    np.testing.assert_array_equal(rendered(empty), both)


@pytest.mark.parametrize("link", [False, True], ids=["appended", "linked"])
def test_a_capture_from_a_composed_file_is_drawn_by_the_other_engine(composed, tmp_path, link):
    """Beside it comes no scene in which FRoG would draw it."""
    name, composed_file = the_capture().name, str(tmp_path / "composed.blend")
    bpy.ops.wm.save_as_mainfile(filepath=composed_file)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (bpy.ops.wm.link if link else bpy.ops.wm.append)(directory=f"{composed_file}/Object/", filename=name)
    capture, scene = the_capture(), bpy.context.scene
    assert (capture.library is not None) == link
    assert not capture.frog.laid_over and point_cloud.is_drawn_in_renders(capture)
    scene.render.engine = "CYCLES"
    assert checks.trouble(scene) == ""


def test_an_animation_follows_cameras_sizes_and_time(composed, rendered, tmp_path):
    """Its frames are those that stills have; the images' size stays the first one's."""
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
    images = [read_png(path) for path in sorted(tmp_path.glob("out_*.png"))]
    assert len(images) == 2
    for frame, image in enumerate(images, start=1):
        composed.frame_set(frame)
        compose_anew(composed)
        found = rendered(composed)
        np.testing.assert_array_equal(image[..., :3], found[..., :3])


@pytest.fixture
def eyes(tmp_path):
    """A function that renders a scene in stereo: the images of the left and the right eye."""

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
    for image, sign in ((left, -0.5), (right, 0.5)):
        moved = place.copy()
        moved.translation += place.col[0].to_3d() * (sign * stereo.interocular_distance)
        camera.matrix_world = moved
        found = rendered(composed).astype(int)
        assert np.abs(found - image).max() <= 2, "an eye is a camera that stands beside the other one"


def test_images_put_together_by_hand_have_the_region_of_the_scene_that_is_rendered(empty, static_rig, rendered):
    """FRoG's scene follows none, but Blender renders it by the other one's size and region all the same."""
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    compose(empty)
    whole = rendered(empty)
    splats_of(empty).frog.composed_with = None
    bpy.context.view_layer.update()
    point_cloud.draw_in_renders(the_capture(), False)
    a_region(empty)
    found = rendered(empty)
    height, width = whole.shape[:2]
    inside = (
        slice(round(0.1 * height) + 1, round(0.9 * height) - 1),
        slice(int(0.2 * width) + 1, int(0.7 * width) - 1),
    )
    np.testing.assert_array_equal(found[inside], whole[inside])
    assert found[inside][..., :3].std() > 10
