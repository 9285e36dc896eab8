"""Which frame to show may be known only when Blender has evaluated it (drivers, the NLA, curves of other settings), and
Time Stretching makes another frame of it: seen, drawn and exported all the same."""

import bpy
import numpy as np
import pytest
from support.small_scenes import animate, expected_png, read_png, rig_of_three, shows

from frog_blender.engine.interchange.ply import read_splats
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline import retiming


def driven(obj):
    """Shows half of the timeline's frame."""
    driver = obj.driver_add("frog.shown_frame").driver
    driver.type, driver.expression = "SCRIPTED", "frame / 2"


def by_curve(obj):
    """The same, which is known before Blender evaluates the frame."""
    animate(obj.frog, "shown_frame", (0, 0.0), (20, 10.0))
    linear(obj.animation_data)


def by_strip(obj):
    """The same, in a strip of the NLA."""
    by_curve(obj)
    animation = obj.animation_data
    action, slot = animation.action, animation.action_slot
    animation.action = None
    strip = animation.nla_tracks.new().strips.new("half", 0, action)
    strip.action_slot = slot


def linear(animation):
    for curve in retiming.curves(animation):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def from_a_start_that_moves(obj):
    """The same: the curve of another setting."""
    obj.frog.use_remap = False
    animate(obj.frog, "start_frame", (0, 0.0), (20, 10.0))
    linear(obj.animation_data)


@pytest.fixture(params=[driven, by_curve, by_strip, from_a_start_that_moves], ids=["driver", "curve", "NLA", "start"])
def halved(request, capture):
    capture.frog.use_remap = True
    request.param(capture)
    return capture


def test_the_timeline_shows_it(empty, halved, static_rig):
    for frame in (6, 3, 4, 12):
        empty.frame_set(frame)
        shows(halved, static_rig, frame / 2)


by_driver = pytest.mark.parametrize("halved", [driven], indirect=True)


@by_driver
def test_stills_and_animations_draw_it(empty, halved, static_rig, tmp_path, rendered):
    empty.frame_set(2)
    empty.frame_set(6)
    np.testing.assert_allclose(
        rendered(empty)[..., :3].astype(float), expected_png(static_rig, rig_of_three()[0], 3.0), atol=1.0
    )
    empty.frame_start, empty.frame_end = 4, 7
    empty.render.filepath = str(tmp_path / "film_")
    bpy.ops.render.render(animation=True)
    for frame in range(4, 8):
        found = read_png(tmp_path / f"film_{frame:04}.png")[..., :3].astype(float)
        np.testing.assert_allclose(found, expected_png(static_rig, rig_of_three()[0], frame / 2), atol=1.0)


def assert_exported(obj, static_rig, folder, frames):
    """That exported files of the scene's frames hold these of the capture."""
    bpy.context.view_layer.objects.active = obj
    bpy.ops.export_scene.frog_frames(filepath=str(folder / "x.ply"), frames="SCENE", apply_transform=False)
    for frame, path in zip(frames, sorted(folder.glob("x*.ply")), strict=True):
        expected = ScenePlayer.load(static_rig).at_frame(frame).means
        np.testing.assert_allclose(read_splats(path).arrays["means"], expected, atol=1e-6)


def test_exported_frames_have_it(empty, halved, static_rig, tmp_path):
    empty.frame_set(1)
    empty.frame_start, empty.frame_end = 4, 6
    assert_exported(halved, static_rig, tmp_path, (2, 2.5, 3))
    assert empty.frame_current == 1


@by_driver
def test_other_engines_draw_it(empty, halved, static_rig, tmp_path, rendered):
    """Cycles, by the points of the frame that was evaluated for it."""
    empty.render.engine, empty.cycles.samples, empty.cycles.device = "CYCLES", 1, "CPU"
    empty.render.resolution_percentage = 25
    empty.render.filepath = str(tmp_path / "film_")
    empty.frame_set(2)
    empty.frame_start, empty.frame_end = 4, 6
    bpy.ops.render.render(animation=True)
    films = [read_png(tmp_path / f"film_{frame:04}.png") for frame in (4, 5, 6)]
    assert np.abs(films[0].astype(float) - films[2]).max() > 10
    halved.animation_data_clear()
    halved.frog.use_remap = True
    for frame, film in zip((4, 5, 6), films, strict=True):
        halved.frog.shown_frame = frame / 2
        np.testing.assert_array_equal(rendered(empty), film)


def test_a_muted_curve_says_nothing(empty, capture, static_rig):
    capture.frog.use_remap = True
    animate(capture.frog, "shown_frame", (1, 0.0), (11, 10.0))
    (curve,) = retiming.curves(capture.animation_data)
    curve.mute, capture.frog.shown_frame = True, 7.0
    empty.frame_set(4)
    shows(capture, static_rig, 7.0)


@pytest.fixture
def slow(empty, capture):
    """Time Stretching to twice the length."""
    empty.render.frame_map_new = 200
    empty.frame_set(5)
    assert empty.frame_current_final == 2.5
    return capture


def test_stretched_time_is_rendered_and_left_where_it_was(empty, slow, static_rig, tmp_path, rendered):
    """With an open shutter and vectors, for which other frames are looked at."""
    sharp = rendered(empty)[..., :3].astype(float)
    np.testing.assert_allclose(sharp, expected_png(static_rig, rig_of_three()[0], 1.5), atol=1.0)
    empty.render.use_motion_blur, empty.render.motion_blur_shutter = True, 0.02
    bpy.context.view_layer.use_pass_vector = True
    np.testing.assert_allclose(rendered(empty)[..., :3].astype(float), sharp, atol=2.0)
    assert (empty.frame_current, empty.frame_subframe) == (5, 0.0)


def test_stretched_time_is_exported(empty, slow, static_rig, tmp_path):
    empty.frame_start, empty.frame_end = 3, 6
    assert_exported(slow, static_rig, tmp_path, (0.5, 1, 1.5, 2))
