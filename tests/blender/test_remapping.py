"""What drivers and the NLA say which frame to show is known when Blender has evaluated it: seen, drawn and rendered."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from scenes import expected_png, read_png, rig_of_three

from frog_blender import carrier, playback
from frog_blender.engine.inference.scene import PlayableScene
from frog_blender.engine.ply import read_splats


def driven(obj):
    """Shows half of the timeline's frame."""
    driver = obj.driver_add("frog.shown_frame").driver
    driver.type, driver.expression = "SCRIPTED", "frame / 2"


def by_strip(obj):
    """The same, in a strip of the NLA."""
    for frame in (0, 20):
        obj.frog.shown_frame = frame / 2
        obj.keyframe_insert("frog.shown_frame", frame=frame)
    animation = obj.animation_data
    for curve in curves_of(animation):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    action, slot = animation.action, animation.action_slot
    animation.action = None
    strip = animation.nla_tracks.new().strips.new("half", 0, action)
    strip.action_slot = slot


def curves_of(animation):
    action = animation.action
    return action.layers[0].strips[0].channelbag(animation.action_slot).fcurves


@pytest.fixture(params=[driven, by_strip], ids=["driver", "NLA"])
def capture(request, empty, static_rig):
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    obj = next(playback.captures(empty.objects))
    obj.frog.use_remap = True
    request.param(obj)
    return obj


def test_the_timeline_shows_it(empty, capture, static_rig):
    for frame in (6, 3, 4, 12):
        empty.frame_set(frame)
        np.testing.assert_array_equal(
            carrier.read(capture)["position"], PlayableScene.load(static_rig).at_frame(frame / 2).means
        )


def test_stills_and_animations_draw_it(empty, capture, static_rig, tmp_path, rendered):
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


def test_exported_frames_have_it(empty, capture, static_rig, tmp_path):
    empty.frame_set(1)
    empty.frame_start, empty.frame_end = 4, 6
    bpy.context.view_layer.objects.active = capture
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "x.ply"), frames="SCENE")
    for frame, path in zip((4, 5, 6), sorted(tmp_path.glob("x*.ply")), strict=True):
        expected = PlayableScene.load(static_rig).at_frame(frame / 2).means
        np.testing.assert_allclose(read_splats(path).arrays["means"], expected, atol=1e-6)
    assert empty.frame_current == 1


def test_other_engines_draw_it(empty, capture, static_rig, tmp_path, rendered):
    """Cycles, by the points of the frame that was evaluated for it."""
    empty.render.engine, empty.cycles.samples, empty.cycles.device = "CYCLES", 1, "CPU"
    empty.render.resolution_percentage = 25
    empty.render.filepath = str(tmp_path / "film_")
    empty.frame_set(2)
    empty.frame_start, empty.frame_end = 4, 6
    bpy.ops.render.render(animation=True)
    films = [read_png(tmp_path / f"film_{frame:04}.png") for frame in (4, 5, 6)]
    assert np.abs(films[0].astype(float) - films[2]).max() > 10
    capture.animation_data_clear()
    for frame, film in zip((4, 5, 6), films, strict=True):
        capture.frog.shown_frame = frame / 2
        np.testing.assert_array_equal(rendered(empty), film)
