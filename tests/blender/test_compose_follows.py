"""After Render With My Objects: whatever a user changes is followed by the next render."""

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
    nodes_of,
    splats_of,
    the_capture,
    the_node_muted,
)
from support.small_scenes import animate, read_png
from support.users_scene import instance_in

from frog_blender import point_cloud
from frog_blender.render.compositing import compositor, renders
from frog_blender.timeline import playback


def write(block, **values):
    for name, value in values.items():
        setattr(block, name, value)


def another_camera(scene):
    scene.camera = cameras(scene)[2]


def a_camera_that_is_not_rendered(scene):
    hidden = collection_in(scene.collection, "cameras")
    scene.camera = cameras(scene)[1].copy()
    scene.camera.location.z += 0.3
    hidden.objects.link(scene.camera)
    scene.view_layers[0].layer_collection.children["cameras"].exclude = True


def a_camera_bound_to_a_marker(scene):
    scene.timeline_markers.new("cut", frame=1).camera = cameras(scene)[-1]


def a_cropped_region(scene):
    a_region(scene)
    scene.render.use_crop_to_border = True


def no_region_and_another_size(scene):
    write(scene.render, use_border=False, resolution_x=72, resolution_y=80, pixel_aspect_y=1.5)


def between_stretched_frames(scene):
    write(scene.render, frame_map_old=100, frame_map_new=200)
    scene.frame_set(8, subframe=0.5)


def motion_blur(scene):
    write(scene.render, use_motion_blur=True, motion_blur_shutter=3.0)


def collections_added(scene):
    inner = collection_in(collection_in(scene.collection, "outer"), "inner")
    card(inner, (0.0, -0.6, -0.3), color=(0.2, 0.3, 0.9))


def an_instance_added(scene):
    instance_in(scene.collection, bpy.data.collections["props"], (0.6, -0.8, -0.2))


def a_simplified_scene(scene):
    obj = bpy.data.objects["card"]
    obj.modifiers.new("round", "SUBSURF").render_levels = 3
    write(scene.render, use_simplify=True, simplify_subdivision_render=0)
    obj.scale, obj.location.y = (1.7, 1.0, 1.7), -1.0


def a_collection_held_out(scene):
    scene.render.film_transparent = True
    scene.view_layers[0].layer_collection.children["outer"].holdout = True


def another_view_layer(scene):
    scene.view_layers[0].use = False
    scene.view_layers.new("mine").layer_collection.children["outer"].exclude = True
    for node in nodes_of(scene, "R_LAYERS"):
        if node.scene == scene:
            node.layer = "mine"


def a_collection_removed(scene):
    scene.collection.children.unlink(bpy.data.collections["props"])


def another_view_transform(scene):
    write(scene.view_settings, view_transform="AgX", exposure=1.0)


def a_capture_added(scene):
    other = the_capture().copy()
    other.parent = None
    other.location.x += 0.8
    scene.collection.objects.link(other)


def a_capture_moved_to_another_collection(scene):
    obj = the_capture()
    (before,) = obj.users_collection
    collection_in(scene.collection, "late").objects.link(obj)
    before.objects.unlink(obj)
    obj.rotation_euler.z += 1.0


def points_switched_on(scene):
    """Which the other engine would draw, and FRoG once more."""
    point_cloud.draw_in("render", the_capture(), True)
    bpy.data.objects["card"].location.y -= 0.3


def renamed_scenes(scene):
    splats_of(scene).name = "Whatever"
    scene.name = "Shot 7"
    scene.timeline_markers.clear()
    scene.camera = cameras(scene)[1]


def the_splats_scene_tampered_with(scene):
    splats = splats_of(scene)
    write(splats.render, engine="CYCLES", film_transparent=False, use_border=True, border_max_x=0.3, resolution_x=20)
    splats.camera, splats.view_layers[0].use = None, False
    scene.frame_set(3)


def undone(scene):
    bpy.ops.ed.undo_push(message="before")
    card(scene.collection, (0.0, -0.6, -0.3))
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="a card")
    bpy.ops.ed.undo()
    bpy.context.scene.camera = cameras(bpy.context.scene)[0]


CHANGES = [
    *(another_camera, a_camera_that_is_not_rendered, a_camera_bound_to_a_marker, a_region, a_cropped_region),
    *(no_region_and_another_size, between_stretched_frames, motion_blur, collections_added, an_instance_added),
    *(a_simplified_scene, a_collection_held_out, another_view_layer, a_collection_removed, another_view_transform),
    *(a_capture_added, a_capture_moved_to_another_collection, points_switched_on, renamed_scenes),
    *(the_splats_scene_tampered_with, undone),
]


@pytest.mark.parametrize("window", [False, True], ids=["script", "window"])
def test_every_change_is_followed(composed, rendered, window, in_a_window):
    """One after the other: each image is that of a scene that was composed after the change."""
    if window:
        in_a_window()
    before, scene = rendered(composed), composed
    for change in CHANGES:
        change(scene)
        scene = bpy.context.scene  # which undo makes anew
        bpy.context.view_layer.update()
        found = rendered(scene)
        assert not renders.problems(), change.__name__
        assert found.shape != before.shape or (found != before).any(), f"{change.__name__} shows"
        compose_anew(scene)
        np.testing.assert_array_equal(found, rendered(scene), err_msg=change.__name__)
        before = found
    for obj in list(playback.captures(bpy.data.objects)):
        bpy.data.objects.remove(obj)
    found = rendered(scene)
    the_node_muted(scene)  # what the objects alone look like
    np.testing.assert_array_equal(found, rendered(scene))


def the_node_unlinked(scene):
    (over,) = nodes_of(scene, "ALPHAOVER")
    target = over.outputs[0].links[0].to_socket
    own = next(node for node in nodes_of(scene, "R_LAYERS") if node.scene == scene)
    compositor.tree_of(scene).links.new(own.outputs["Image"], target)


def the_splats_scene_deleted(scene):
    bpy.data.scenes.remove(splats_of(scene))


def the_nodes_deleted(scene):
    compositor.tree_of(scene).nodes.clear()
    scene.render.use_compositing = False


def test_captures_that_frog_no_longer_draws_are_drawn_by_the_other_engine(empty, capture, rendered):
    card(empty.collection, (0.4, 0.0, 0.0))
    empty.render.engine, empty.cycles.samples, empty.cycles.use_denoising = "CYCLES", 1, False
    before = rendered(empty)
    compose(empty)
    both = rendered(empty)
    assert (both != before).any() and not point_cloud.is_drawn_in("render", the_capture())
    for change in (the_node_unlinked, the_splats_scene_deleted, the_nodes_deleted):
        change(empty)
        np.testing.assert_array_equal(rendered(empty), before, err_msg=change.__name__)
        compose(empty)
        np.testing.assert_array_equal(rendered(empty), both, err_msg=change.__name__)


@pytest.mark.parametrize("link", [False, True], ids=["appended", "linked"])
def test_a_capture_from_a_composed_file_is_drawn_by_the_other_engine(composed, tmp_path, link):
    """Beside it comes no scene in which FRoG would draw it."""
    name, composed_file = the_capture().name, str(tmp_path / "composed.blend")
    bpy.ops.wm.save_as_mainfile(filepath=composed_file)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (bpy.ops.wm.link if link else bpy.ops.wm.append)(directory=f"{composed_file}/Object/", filename=name)
    capture, scene = the_capture(), bpy.context.scene
    assert (capture.library is not None) == link
    assert not capture.frog.laid_over and point_cloud.is_drawn_in("render", capture)
    scene.render.engine = "CYCLES"
    assert renders.trouble(scene) == ""


def test_an_animation_follows_cameras_and_settings(composed, rendered, tmp_path):
    """Its frames are those that stills have."""
    for frame, camera in zip((1, 2), (cameras(composed)[0], cameras(composed)[2]), strict=True):
        composed.timeline_markers.new("cut", frame=frame).camera = camera
    composed.render.use_motion_blur = True
    animate(composed.render, "motion_blur_shutter", (1, 0.0), (2, 4.0))
    composed.frame_start, composed.frame_end = 1, 2
    write(composed.render, filepath=str(tmp_path / "out_"))
    composed.render.image_settings.file_format = "PNG"
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    images = [read_png(path) for path in sorted(tmp_path.glob("out_*.png"))]
    assert len(images) == 2
    for frame, image in enumerate(images, start=1):
        composed.frame_set(frame)
        compose_anew(composed)
        np.testing.assert_array_equal(image[..., :3], rendered(composed)[..., :3])


def test_each_eye_has_its_own_splats(composed, rendered, tmp_path):
    def eyes():
        write(composed.render, use_multiview=True, views_format="STEREO_3D", filepath=str(tmp_path / "stereo.png"))
        write(composed.render.image_settings, file_format="PNG", views_format="INDIVIDUAL")
        assert bpy.ops.render.render(write_still=True, scene=composed.name) == {"FINISHED"}
        return [read_png(tmp_path / f"stereo_{eye}.png") for eye in "LR"]

    camera = composed.camera
    left, right = eyes()
    assert (left != right).any()
    write(camera.data.stereo, convergence_mode="PARALLEL", pivot="CENTER")
    left, right = eyes()
    composed.render.use_multiview = False
    place = camera.matrix_world.copy()
    for image, sign in ((left, -0.5), (right, 0.5)):
        moved = place.copy()
        moved.translation += place.col[0].to_3d() * (sign * camera.data.stereo.interocular_distance)
        camera.matrix_world = moved
        found = rendered(composed).astype(int)
        assert np.abs(found - image).max() <= 2, "an eye is a camera that stands beside the other one"
