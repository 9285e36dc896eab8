"""Trim, limits, curve: what is shown when, in every consumer, and undone. And what fits the
scene to a capture, or its speed to the film."""

import json

import bpy
import numpy as np
import pytest
from support.builders import refuses
from support.foreign_takes import assert_equal_within
from support.small_scenes import animate, edit_everything, expected_png, read_png, rig_of_three, write_scene
from support.undo_steps import check_undo_and_redo

from frog_blender import point_cloud
from frog_blender.cli.main import main
from frog_blender.engine.interchange.ply import read_splats
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.scene_import.capture_objects import select_capture
from frog_blender.timeline import playback, retiming, timing_curve
from frog_blender.timeline.frame_timing import frames_shown, timing_of
from frog_blender.ui import timing_panel

COUNT = 30


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path / "figure.frog", rig_of_three(), frame_count=COUNT)


def test_a_piece_is_played_alone(empty, capture):
    capture.frog.use_trim = True
    assert capture.frog.last_frame == COUNT - 1, "all of it, until the user says less"
    capture.frog.first_frame, capture.frog.last_frame = 5, 8
    capture.frog.start_frame = 3.0
    assert frames_shown(capture, empty, range(1, 10)) == [5, 5, 5, 6, 7, 8, 8, 8, 8]
    capture.frog.repeat = "LOOP"
    assert frames_shown(capture, empty, range(1, 10)) == [7, 8, 5, 6, 7, 8, 5, 6, 7]
    capture.frog.repeat = "PING_PONG"
    assert frames_shown(capture, empty, range(3, 12)) == [5, 6, 7, 8, 7, 6, 5, 6, 7]
    capture.frog.speed = -0.5
    assert frames_shown(capture, empty, range(3, 7)) == [5, 5.5, 6, 6.5]
    assert retiming.playing_frames(capture, empty, COUNT) == (-3, 3)
    capture.frog.first_frame, capture.frog.last_frame = 99, 2
    assert frames_shown(capture, empty, [4]) == [COUNT - 1], "what cannot be is as near as can be"


def test_what_is_not_there_is_seen_by_nobody(empty, capture, path, tmp_path, rendered):
    capture.frog.range_start, capture.frog.range_end, capture.frog.use_range = 3.0, 6.0, True
    full = expected_png(path, rig_of_three()[0], 3.0)
    for frame, is_there in ((2, False), (3, True), (5, True), (6, False)):
        empty.frame_set(frame)
        assert bool(point_cloud.read(capture)["radiance:base"][:, 3].any()) == is_there
        image = rendered(empty)[..., :3].astype(float)
        assert (np.ptp(image, axis=(0, 1)).max() > 20) == is_there
    empty.frame_set(4)
    np.testing.assert_allclose(rendered(empty)[..., :3].astype(float), full, atol=1.0)
    select_capture(bpy.context, capture)
    options = {"frames": "CUSTOM", "first": 2, "last": 6, "apply_transform": False}
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "x.ply"), **options)
    files = [read_splats(file).arrays for file in sorted(tmp_path.glob("x*.ply"))]
    assert [bool((file["opacity_logits"] > -20).any()) for file in files] == [False, True, True, True, False]
    assert len({len(file["means"]) for file in files}) == 1, "files of a sequence have as many"


@pytest.mark.parametrize(("repeat", "speed"), [("HOLD", 1.0), ("LOOP", 0.5), ("LOOP", -0.5), ("PING_PONG", 0.4)])
def test_a_curve_plays_as_the_settings_did(empty, capture, repeat, speed):
    capture.frog.repeat, capture.frog.speed, capture.frog.start_frame = repeat, speed, 4.0
    capture.frog.first_frame, capture.frog.last_frame, capture.frog.use_trim = 3, 17, True
    empty.frame_start, empty.frame_end = 0, 90
    numbers = range(91)
    before = frames_shown(capture, empty, numbers)
    for earlier in ([], [(1, 3.0), (20, 9.0), (900, 5.0)]):
        animate(capture.frog, "shown_frame", *earlier)
        assert bpy.ops.frog.timing_to_curve() == {"FINISHED"} and capture.frog.use_remap
        shown = np.clip(frames_shown(capture, empty, numbers), 3, 17)
        np.testing.assert_allclose(shown, np.clip(before, 3, 17), atol=1e-3)
        assert not bpy.ops.frog.timing_to_curve.poll()
        capture.frog.use_remap = False
    retiming.shown_curve(capture).modifiers.new("CYCLES")
    assert not bpy.ops.frog.timing_to_curve.poll(), "it would play otherwise"


def test_everything_is_undone(empty, capture):
    name = capture.name

    def state():
        obj = bpy.data.objects[name]
        curve = retiming.shown_curve(obj)
        keys = [tuple(point.co) for point in curve.keyframe_points] if curve is not None else []
        settings = [getattr(obj.frog, setting) for setting in ("start_frame", "speed", "use_remap", "use_range")]
        return keys, settings, len(bpy.data.objects)

    def retimed():
        select_capture(bpy.context, bpy.data.objects[name])
        assert bpy.ops.frog.timing_to_curve() == {"FINISHED"}

    empty.frame_set(11)
    check_undo_and_redo([retimed], state)


def test_a_driven_time_is_left_alone(empty, capture, tmp_path):
    capture.frog.use_remap = True
    capture.driver_add("frog.shown_frame").driver.expression = "frame / 2"
    assert not bpy.ops.frog.timing_to_curve.poll()
    assert "driven" in timing_curve.problem(capture)
    saved = tmp_path / "e.json"
    saved.write_text('{"frog_edits": 1, "time": {"rate": 24, "frames": [3, 4]}, "grades": [{"exposure": 1}]}')
    refuses("cannot be edited", bpy.ops.frog.load_edits, filepath=str(saved))
    assert capture.frog_edits.grade.exposure == 0, "nothing has changed"
    empty.frame_set(7)
    assert frames_shown(capture, empty, range(2, 6)) == [1, 1.5, 2, 2.5] and empty.frame_current == 7


def test_a_timing_lasts_as_long_at_any_rate(empty, capture, tmp_path):
    saved = tmp_path / "e.json"
    empty.render.fps, empty.render.frame_map_new = 24, 200
    assert bpy.ops.frog.save_edits(filepath=str(saved)) == {"FINISHED"}
    assert json.loads(saved.read_text())["time"]["frames"][:3] == [0, 0, 0.5], "stretched time is no plain one"
    empty.render.frame_map_new, capture.frog.start_frame = 100, 1.0
    saved.write_text('{"frog_edits": 1, "time": {"rate": 24, "frames": [3, 4, 5, 6, null]}}')
    empty.render.fps = 48
    assert bpy.ops.frog.load_edits(filepath=str(saved)) == {"FINISHED"}
    np.testing.assert_allclose(frames_shown(capture, empty, range(1, 8)), [3, 3.5, 4, 4.5, 5, 5.5, 6], atol=1e-3)
    assert frames_shown(capture, empty, [8, 9])[1] is None
    empty.render.fps, empty.render.fps_base = 32_000, 1.0
    refuses("frames a second", bpy.ops.frog.save_edits, filepath=str(saved))


def test_a_file_of_edits_has_the_timing_and_gives_the_images_of_f12(empty, capture, path, tmp_path, rendered):
    pytest.importorskip("cv2")
    pytest.importorskip("tqdm")
    bpy.ops.frog.save_edits(filepath=str(tmp_path / "plain.json"))
    assert "time" not in json.loads((tmp_path / "plain.json").read_text())
    empty.frame_set(5)
    edit_everything(capture)
    capture.frog.use_remap = True
    animate(capture.frog, "shown_frame", (1, 0.0), (5, 4.0), (13, 4.0), (21, 12.0))
    capture.frog.range_start, capture.frog.range_end, capture.frog.use_range = 3.0, 20.0, True
    saved, out = tmp_path / "e.json", tmp_path / "out"
    assert bpy.ops.frog.save_edits(filepath=str(saved)) == {"FINISHED"}
    expected, edited = timing_of(capture, empty), playback.scene_time(capture, 5).gaussians()
    assert main(["render", str(path), "--camera", "cam00", "--edits", str(saved), "--out", str(out)]) == 0
    files = sorted(out.glob("*.png"))
    assert len(files) == empty.frame_end - empty.frame_start + 1
    empty.render.film_transparent = False
    for frame in (1, 8, 12, 19, 20):
        empty.frame_set(frame)
        ours = read_png(files[frame - 1]).astype(int)[..., :3]
        assert np.abs(ours - rendered(empty).astype(int)[..., :3]).max() <= 1
    for name in ("use_range", "use_remap"):
        capture.frog.property_unset(name)
    for name in ("grade", "hidden"):
        capture.frog_edits.property_unset(name)
    capture.animation_data_clear()
    assert bpy.ops.frog.load_edits(filepath=str(saved)) == {"FINISHED"}
    again = timing_of(capture, empty)
    assert_equal_within(playback.scene_time(capture, 5).gaussians(), edited, 1e-5, 1e-5)
    assert [frame is None for frame in again.frames] == [frame is None for frame in expected.frames]
    values = [[frame for frame in timing.frames if frame is not None] for timing in (again, expected)]
    np.testing.assert_allclose(*values, atol=1e-3)
    assert len(retiming.shown_curve(capture).keyframe_points) < 14, "straight lines are two keys"


def test_half_speed_takes_twice_the_frames(empty, capture):
    assert (empty.frame_start, empty.frame_end) == (1, COUNT)
    assert timing_panel._told_of_frames(capture, empty) == ""
    capture.frog.speed = 0.5
    told = timing_panel._told_of_frames(capture, empty)
    assert f"Plays in frames 1 to {2 * COUNT - 1}. The scene has 1 to {COUNT}." in told and "0.5 times" in told
    assert bpy.ops.frog.fit_frame_range() == {"FINISHED"}
    assert (empty.frame_start, empty.frame_end) == (1, 2 * COUNT - 1)
    assert playback.shown_frame(capture, empty.frame_end) == COUNT - 1
    capture.frog.start_frame, capture.frog.speed = 100.0, -1.0
    assert bpy.ops.frog.fit_frame_range() == {"FINISHED"}
    assert (empty.frame_start, empty.frame_end) == (101 - COUNT, 100)


@pytest.mark.parametrize(("rate", "base", "stretch"), [(24, 1.0, 100), (30, 1.001, 100), (25, 1.0, 200)])
def test_real_time_is_that_of_the_film(empty, capture, rate, base, stretch):
    header = ScenePlayer.load(playback.file_of(capture)).header
    empty.render.fps, empty.render.fps_base, empty.render.frame_map_new = rate, base, stretch
    said = retiming.other_rate(empty, header)
    assert (f"filmed at {header.frames_per_second:g} frames a second" in said) is (rate / base * stretch / 100 != 24)
    assert bpy.ops.frog.play_in_real_time() == {"FINISHED"}
    assert bpy.ops.frog.fit_frame_range() == {"FINISHED"}
    seconds = header.frame_count / header.frames_per_second
    frames = empty.frame_end - empty.frame_start + 1
    assert abs(frames * base / rate - seconds) < 2 * base / rate + 1 / header.frames_per_second
    empty.frame_set(empty.frame_start)
    first = playback.shown_frame(capture, empty.frame_current_final)
    empty.frame_set(empty.frame_start + round(rate / base))
    shown = playback.shown_frame(capture, empty.frame_current_final) - first
    assert shown == pytest.approx(header.frames_per_second, rel=0.05), "in a second"


def test_what_cannot_be_fitted_is_grey(empty, capture, static_rig):
    capture.frog.use_remap = True
    assert not bpy.ops.frog.fit_frame_range.poll() and not bpy.ops.frog.play_in_real_time.poll()
    capture.frog.use_remap, capture.frog.speed = False, 0.0
    assert not bpy.ops.frog.fit_frame_range.poll() and bpy.ops.frog.play_in_real_time.poll()
    capture.frog.speed = 1e-9
    refuses("which no scene has", bpy.ops.frog.fit_frame_range)
    bpy.data.objects.remove(capture)
    assert not bpy.ops.frog.fit_frame_range.poll()
