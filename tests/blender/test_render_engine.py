"""F12 through an imported camera is the engine's own drawing of that camera."""

import json
import warnings

import bpy
import mathutils
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from support.builders import REPOSITORY, refused, refuses
from support.exr import pass_of, render_channels
from support.observed_players import observed
from support.small_scenes import (
    animate,
    expected_png,
    imported,
    moving_camera,
    passes_of,
    read_png,
    rig_of_three,
    write_scene,
)
from support.users_scene import eye_in

from frog_blender import reported_once
from frog_blender.cameras import engine_camera
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import joined
from frog_blender.engine.native import binding
from frog_blender.engine.notices import Notice
from frog_blender.engine.playback.passes import combined_pass
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.views import read_cameras
from frog_blender.render.blur import shutter_frames
from frog_blender.timeline.retiming import curves


def look_through(scene, name):
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    assert bpy.ops.frog.look_through() == {"FINISHED"}


def assert_same_image(pixels, expected):
    assert pixels.shape[:2] == expected.shape[:2]
    assert expected.std() > 10.0, "the test's own image is empty"
    np.testing.assert_allclose(pixels[..., :3].astype(float), expected, atol=1.0)


def test_stills_through_each_camera_wherever_its_root_stands(empty, capture, static_rig, rendered):
    turn = mathutils.Euler((0.3, -0.8, 1.9)).to_matrix().to_4x4()
    elsewhere = mathutils.Matrix.Translation((5.0, 2.0, -1.0)) @ turn @ mathutils.Matrix.Scale(2.5, 4)
    for index, frame, place in ((0, 4.25, None), (1, 5, None), (2, 7, elsewhere)):
        capture.parent.matrix_world = place or mathutils.Matrix()
        look_through(empty, f"cam0{index}")
        empty.frame_set(int(frame), subframe=frame % 1)
        pixels = rendered(empty)
        assert_same_image(pixels, expected_png(static_rig, rig_of_three()[index], frame - 1))
        assert pixels[..., 3].min() == 255


def test_what_cannot_be_drawn_is_refused_in_a_sentence(empty, capture, static_rig, rendered):
    capture.scale = (1.0, 2.0, 1.0)
    refuses("can only be scaled evenly", rendered, empty)
    capture.scale = (1.0, 1.0, 1.0)
    static_rig.unlink()
    refuses("found no file", rendered, empty)


@pytest.mark.parametrize("blurred", [False, True], ids=["vectors", "motion blur"])
def test_other_frames_that_fail_leave_the_frame(empty, capture, rendered, blurred):
    empty.frame_set(5, subframe=0.25)
    empty.render.use_motion_blur, bpy.context.view_layer.use_pass_vector = blurred, not blurred

    def giving(player, time):
        if time != player.time_of(4.25):
            raise FrogError("x.frog: found no file, expected a .frog scene.")

    with observed(giving=giving), pytest.raises(RuntimeError, match="found no file"):
        rendered(empty)
    assert empty.frame_current_final == 5.25


def test_orthographic_camera_sees_no_perspective(empty, capture, static_rig, tmp_path):
    """What lies further away looks no smaller, and Depth is the distance from Blender's camera."""
    data = empty.camera.data
    data.type, data.ortho_scale, data.shift_x, data.shift_y, data.frog.focal_ratio = "ORTHO", 3.0, 0.0, 0.0, 1.0
    combined, depth = passes_of(empty, tmp_path)
    means = ScenePlayer.load(static_rig).at_frame(0.0).means
    to_eye = np.linalg.inv(np.array(empty.camera.matrix_world))
    seen = means @ to_eye[:3, :3].T + to_eye[:3, 3]
    covered = depth < 1e9
    assert covered.sum() > 200
    # Depths of the image are depths of Gaussians, to what float32 holds of a camera so far away.
    nearest = np.abs(depth[covered][:, None] + seen[None, :, 2]).min(axis=1)
    assert nearest.max() < 2e-3
    # Stepping back changes nothing but the distance.
    back = np.array(empty.camera.matrix_world)[:3, 2]
    empty.camera.location += mathutils.Vector(2.0 * back)
    further, depth_further = passes_of(empty, tmp_path)
    assert np.abs(further - combined).max() < 0.02
    change = np.abs(depth_further[covered] - depth[covered] - 2.0)
    assert np.quantile(change, 0.98) < 5e-3  # at edges another Gaussian may take transmittance through a half


def test_motion_blur_is_the_light_of_the_open_shutter(empty, capture, tmp_path):
    """Against 60 frames over the same time; cameras move as well as Gaussians."""
    camera = empty.camera
    _, y, z = camera.location
    animate(camera, "location", (1, (-1.0, y, z)), (10, (1.0, y, z)))
    empty.frame_set(5)
    sharp, depth = passes_of(empty, tmp_path)
    empty.render.motion_blur_position, empty.render.motion_blur_shutter = "START", 1.0
    empty.render.use_motion_blur = True
    blurred, same_depth = passes_of(empty, tmp_path)
    assert empty.frame_current_final == 5.0
    empty.render.use_motion_blur = False
    expected = np.zeros_like(sharp)
    for frame in 5.0 + (np.arange(60) + 0.5) / 60:
        empty.frame_set(int(frame), subframe=frame % 1.0)
        expected += passes_of(empty, tmp_path)[0] / 60
    change = np.abs(expected - sharp).max()
    assert change > 0.05, "nothing moves"
    assert np.abs(blurred - expected).max() < 0.03 * change + 2e-3
    np.testing.assert_array_equal(depth, same_depth)


def test_the_shutter_is_open_where_blender_says():
    for position, first, last in (("START", 7.0, 7.5), ("CENTER", 6.75, 7.25), ("END", 6.5, 7.0)):
        frames = shutter_frames(7.0, 0.5, position, 16)
        assert len(frames) == 16 and first < frames[0] < frames[-1] < last
        assert np.mean(frames) == pytest.approx((first + last) / 2)


def test_moving_capture_becomes_one_animated_camera(empty, moving_rig, rendered):
    imported(moving_rig)
    cameras = [obj for obj in empty.objects if obj.type == "CAMERA"]
    assert len(cameras) == 1
    keyed = [curve for block in (cameras[0], cameras[0].data) for curve in curves(block.animation_data)]
    assert {key.interpolation for curve in keyed for key in curve.keyframe_points} == {"LINEAR"} and len(keyed) > 7
    for frame in (5, 0, 3):
        empty.frame_set(frame + 1)
        assert_same_image(rendered(empty), expected_png(moving_rig, moving_camera(6)[frame], float(frame)))


def test_two_captures_are_drawn_together(empty, static_rig, tmp_path, rendered):
    other = write_scene(tmp_path / "other.frog", rig_of_three(), seed=1, sh_count=1, low_pass=0.8)
    imported(static_rig)
    imported(other)
    look_through(empty, "cam00")
    both = joined([ScenePlayer.load(path).at_frame(0.0) for path in (static_rig, other)])
    assert both.sh.shape == (120, 4, 3)
    image = draw(both, rig_of_three()[0], background=(0.1, 0.2, 0.3)).rgb
    assert_same_image(rendered(empty), np.clip(image, 0.0, 1.0) * 255.0)


def test_depth_is_planar_and_in_world_units(empty, capture, static_rig, tmp_path):
    capture.parent.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.use_pass_z = True
    _, depth = passes_of(empty, tmp_path)
    expected = draw(ScenePlayer.load(static_rig).at_frame(0.0), rig_of_three()[0]).median_z
    nothing = np.isnan(expected)
    assert 0.02 < nothing.mean() < 0.98
    assert np.mean((depth == np.float32(1e10)) == nothing) > 0.99
    both = ~nothing & (depth < 1e9)
    # A median may jump to a neighbour where two Gaussians tie at one half; nearly all pixels agree.
    assert np.mean(np.abs(depth[both] - 2.0 * expected[both]) < 1e-3) > 0.98


@pytest.mark.parametrize("size", [(80, 50), (50, 80)])
@pytest.mark.parametrize("aspect", [(1.0, 1.0), (2.0, 1.0), (1.0, 1.5)])
def test_camera_projects_as_blender_does(empty, size, aspect):
    obj = eye_in(empty, sensor_width=32.0, sensor_height=20.0, lens=41.0, shift_x=0.13, shift_y=-0.07)
    obj.location, obj.rotation_euler = (0.5, -3.0, 1.0), (1.2, 0.1, 0.3)
    empty.render.resolution_x, empty.render.resolution_y = size
    empty.render.pixel_aspect_x, empty.render.pixel_aspect_y = aspect
    points = np.array([[0.0, 0.0, 0.0], [0.4, 0.2, 0.3], [-0.3, 0.1, 0.8]])
    for fit in ("AUTO", "HORIZONTAL", "VERTICAL"):
        obj.data.sensor_fit = fit
        bpy.context.view_layer.update()
        pixels, depth = engine_camera(obj, obj.matrix_world, empty.render, *size).project(points)
        for point, pixel, z in zip(points, pixels, depth, strict=True):
            x, y, distance = world_to_camera_view(empty, obj, mathutils.Vector(point))
            np.testing.assert_allclose(pixel, (x * size[0], (1.0 - y) * size[1]), atol=1e-3)
            assert z == pytest.approx(distance, rel=1e-5)


def test_a_render_region_is_that_part_of_the_image(empty, capture, rendered):
    empty.render.resolution_x, empty.render.resolution_y = 100, 60
    whole = rendered(empty)
    for share in (0.07, 0.29, 0.57, 0.58, 0.7, 0.95):
        empty.render.border_min_x, empty.render.border_max_x = share, 1.0
        empty.render.border_min_y, empty.render.border_max_y = 0.0, share
        part = rendered(empty, use_border=True, use_crop_to_border=True)
        height, width = part.shape[:2]
        np.testing.assert_array_equal(part, whole[-height:, -width:])
        image = rendered(empty, use_crop_to_border=False)
        assert image.shape == whole.shape and not image[:-height].any(), "outside the region nothing is drawn"
        np.testing.assert_array_equal(image[-height:, -width:], part)


def test_a_strip_of_the_sequencer_has_a_camera_of_its_own(empty, capture, tmp_path, rendered):
    look_through(empty, "cam00")
    cut = bpy.data.scenes.new("Cut")
    cut.render.resolution_x, cut.render.resolution_y = empty.render.resolution_x, empty.render.resolution_y
    cut.view_settings.view_transform = empty.view_settings.view_transform
    editor = cut.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strip = strips.new_scene("shot", empty, channel=1, frame_start=1)
    strip.scene_camera = bpy.data.objects["cam02"]
    cut.render.filepath = str(tmp_path / "cut.png")
    bpy.ops.render.render(write_still=True, scene=cut.name)
    found = read_png(tmp_path / "cut.png")
    assert np.abs(rendered(empty)[..., :3].astype(float) - found[..., :3]).max() > 50
    empty.camera = bpy.data.objects["cam02"]
    np.testing.assert_allclose(rendered(empty)[..., :3].astype(float), found[..., :3], atol=1.0)


def test_nothing_behind_an_orthographic_camera_is_drawn(empty, capture, tmp_path):
    empty.render.film_transparent = True
    empty.camera.data.type, empty.camera.data.ortho_scale = "ORTHO", 4.0
    for height, is_seen in ((50.0, True), (-50.0, False)):
        empty.camera.matrix_world = mathutils.Matrix.Translation((0.0, 0.0, height))
        assert (passes_of(empty, tmp_path)[0][..., 3].max() > 0.3) == is_seen


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="Blender 5 has other working spaces")
def test_colours_are_the_same_in_any_working_space(empty, static_rig, rendered):
    imported(static_rig)
    expected = rendered(empty).astype(float)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.set_working_color_space(working_space="Linear Rec.2020", convert_colors=False)
    try:
        imported(static_rig)
        scene = bpy.context.scene
        found = rendered(scene)
        scene.world = None  # then the capture's own background
        without_world = rendered(scene)
    finally:
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=False)
    np.testing.assert_allclose(found, expected, atol=1.0)
    np.testing.assert_allclose(without_world, expected, atol=1.0)


def test_a_capture_in_edit_mode_is_drawn(empty, capture, rendered):
    before = rendered(empty)
    bpy.context.view_layer.objects.active = capture
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        np.testing.assert_array_equal(rendered(empty), before)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize(("most", "blurred"), [(0, False), (0, True), (10**9, True)])
def test_an_image_that_takes_long_says_so_once(empty, capture, rendered, monkeypatch, capfd, most, blurred):
    """Here every image does, or none."""
    assert empty.cycles.transparent_max_bounces == 1024, "Cycles sees through all layers"
    empty.render.use_motion_blur = blurred
    monkeypatch.setattr(binding, "MANY_INSTANCES", most)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert rendered(empty).std() > 10
    sentence = "Warning: Many of the 60 Gaussians cover most of the image; drawing it takes seconds."
    assert "".join(capfd.readouterr()).count(sentence) == (most == 0)
    assert not [warning for warning in told if warning.category is Notice], "said twice"


@pytest.mark.parametrize("error", [ZeroDivisionError("all"), FrogError("all"), MemoryError("all")], ids=repr)
def test_what_nobody_foresaw_leaves_its_traceback(empty, capture, capfd, error):
    def fail(player, time):
        raise error

    reported_once.forget()
    said = r"Out of memory \(all\)" if isinstance(error, MemoryError) else "all"
    for _ in range(2):
        with observed(giving=fail), pytest.raises(RuntimeError, match=said):
            bpy.ops.render.render()
    tracebacks = capfd.readouterr().err.split("Traceback")[1:]
    assert len(tracebacks) == isinstance(error, ZeroDivisionError)
    assert all("in fail" in traceback for traceback in tracebacks)


def test_a_camera_path_of_blender_shows_the_same_elsewhere(empty, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "examples")
    from camera_path import camera_path

    path = write_scene(tmp_path / "x.frog", rig_of_three())
    capture = imported(path)
    capture.parent.location, capture.parent.scale, capture.frog.start_frame = (0.5, 0.2, 0.1), (1.5,) * 3, -2
    empty.frame_start, empty.frame_end, empty.render.engine = 1, 3, "FROG"
    eye = eye_in(empty, turn=(np.pi / 2, 0, 0))
    animate(eye, "location", (1, (0.0, -5.0, 0.0)), (3, (0.8, -4.0, 0.3)))
    empty.render.resolution_x, empty.render.resolution_y, empty.render.resolution_percentage = 96, 64, 50
    empty.render.film_transparent = True
    images = camera_path("frog_blender", empty, None)
    (tmp_path / "path.json").write_text(json.dumps({"frames": images}))
    scene = ScenePlayer.load(path)
    views = read_cameras(tmp_path / "path.json", scene.header)
    assert [(view.number, view.frame) for view in views] == [(1, 3.0), (2, 4.0), (3, 5.0)]
    for view in views:
        empty.frame_set(view.number)
        filmed = pass_of(render_channels(empty, tmp_path / "f12.exr"), "Combined", "RGBA")
        drawn = combined_pass(draw(scene.at_frame(view.frame), view.camera), None, 48, 32)
        assert filmed[..., 3].max() > 0.5 and np.abs(filmed - drawn).max() < 2e-3
    capture.parent.scale = 1, 2, 1
    refused("stretched", camera_path, "frog_blender", empty, None)
    refused("0 captures nobody", camera_path, "frog_blender", empty, "nobody")
