"""Crop, clean and grade in Blender: the same in points, renders, exports and files; copying and undo keep it."""

import re
import threading
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest
from support.builders import refused, refuses
from support.small_scenes import animate, cropped, edit_everything, rig_of_three, write_scene
from support.training_panel import finish, panel_says
from support.users_scene import instance_in

from frog_blender import point_cloud
from frog_blender.engine.editing import selections
from frog_blender.engine.editing.clean_up import CLEANING, clean_up
from frog_blender.engine.editing.edited_scene import edited
from frog_blender.engine.editing.edits_file import load_edits
from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.playback.importance import camera_weights
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.operators import bases, edit_clean
from frog_blender.operators.worked_out import WorkedOutEdit
from frog_blender.render.collect_instances import gather, visible_captures
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.tasks.scene_work import SceneWork
from frog_blender.timeline import edits, playback
from frog_blender.ui import captures_panel, edit_panel


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path / "scene.frog", rig_of_three(), count=200)


def assert_points_are_what_is_rendered(obj, frame):
    gaussians, points = playback.scene_time(obj, frame).gaussians(), point_cloud.read(obj)
    np.testing.assert_array_equal(points["position"], gaussians.means)
    np.testing.assert_array_equal(points["radiance:base"][:, 3], gaussians.opacities)
    np.testing.assert_array_equal(points["radiance:base"][:, :3], gaussians.sh[:, 0])
    np.testing.assert_array_equal(points["scale"], gaussians.scales)


def assert_same(gaussians, expected, atol=0.0):
    for name, values in expected.arrays.items():
        np.testing.assert_allclose(getattr(gaussians, name), values, rtol=0, atol=atol, err_msg=name)


def test_points_follow_every_edit_at_every_frame(empty, capture):
    plain = playback.scene_time(capture, 1).gaussians()
    edit_everything(capture)
    assert point_cloud.count(capture) < 200
    for frame in (1, 4, 10, 2.5):
        empty.frame_set(int(frame), subframe=frame % 1)
        assert_points_are_what_is_rendered(capture, frame)
    capture.frog_edits.use = False
    empty.frame_set(1)
    np.testing.assert_array_equal(point_cloud.read(capture)["position"], plain.means)
    np.testing.assert_array_equal(playback.scene_time(capture, 1).gaussians().sh, plain.sh)


@pytest.mark.parametrize("shape", ["BOX", "SPHERE"])
def test_a_new_crop_holds_what_the_cameras_see_and_is_what_is_selected(empty, capture, path, shape):
    scene = ScenePlayer.load(path)
    seen = camera_weights(scene).any(axis=0)
    bpy.ops.object.select_all(action="SELECT")
    assert bpy.ops.frog.add_crop(shape=shape) == {"FINISHED"}
    crop = capture.frog_edits.crops[0].object
    assert bpy.context.selected_objects == [crop] and bpy.context.object == crop
    assert active_capture(bpy.context) == capture
    for frame in range(1, 11):
        empty.frame_set(frame)
        opacities = playback.scene_time(capture, frame).gaussians().opacities
        np.testing.assert_array_equal(opacities[seen], scene.at_frame(frame - 1).opacities[seen])
    assert seen.sum() > 150
    assert (np.abs(scene.at_frame(0).means[seen] - crop.location) < 0.9 * np.array(crop.scale)).all(1).any()


def test_what_a_crop_would_take_away_is_tinted_while_it_is_transformed(capture, monkeypatch):
    crop = cropped(capture, scale=0.3)
    plain = ScenePlayer.load(playback.file_of(capture)).at_frame(0)
    kept = playback.scene_time(capture, 1).gaussians().opacities
    assert 0 < np.count_nonzero(kept) < point_cloud.count(capture)
    monkeypatch.setattr(edits, "is_transforming", lambda: True)
    later = []
    monkeypatch.setattr(playback, "later", lambda function, _seconds: later.append(function))
    shown = playback.displayed(capture, 1).gaussians()
    inside = np.abs((plain.means - crop.location) / np.array(crop.scale)).max(1) <= 1
    np.testing.assert_array_equal(shown.opacities, plain.opacities)
    np.testing.assert_array_equal(shown.sh[inside], plain.sh[inside])
    assert (shown.sh[~inside, 0, 0] != plain.sh[~inside, 0, 0]).all() and 10 < inside.sum() < 190
    np.testing.assert_array_equal(playback.scene_time(capture, 1).gaussians().opacities, kept)
    assert later[0]() == pytest.approx(0.1), "looked at again"
    crop.select_set(False)
    assert playback.displayed(capture, 1).gaussians().opacities.sum() == kept.sum(), "something else is moved"
    monkeypatch.setattr(edits, "is_transforming", lambda: False)
    assert later[0]() is None
    np.testing.assert_array_equal(point_cloud.read(capture)["radiance:base"][:, 3], kept)


def test_a_crop_that_is_moved_or_animated_is_followed(empty, capture):
    crop = cropped(capture)
    before = np.count_nonzero(playback.scene_time(capture, 1).gaussians().opacities)
    crop.scale *= 0.5
    bpy.context.view_layer.update()
    smaller = np.count_nonzero(point_cloud.read(capture)["radiance:base"][:, 3])
    assert 0 < smaller < before
    assert not edits.needs_evaluation(capture)
    x, y, z = crop.location
    animate(crop, "location", (1, (x, y, z)), (10, (x + 100, y, z)))
    capture.frog_edits.grade.keyframe_insert("exposure", frame=1)
    assert edits.needs_evaluation(capture)
    for frame in (1, 10, 5):
        empty.frame_set(frame)
        assert_points_are_what_is_rendered(capture, frame)
    empty.frame_set(10)
    assert not playback.scene_time(capture, 10).gaussians().opacities.any()


@pytest.mark.parametrize("shape", ["BOX", "SPHERE", "OBJECT"])
@pytest.mark.parametrize("feather", [0.0, 0.4])
def test_a_crop_scaled_through_its_middle_keeps_what_lies_in_it(empty, capture, tmp_path, monkeypatch, shape, feather):
    if shape == "OBJECT":
        bpy.ops.mesh.primitive_cube_add(size=2.0)
        solid = bpy.context.object
        capture.select_set(True)
        bpy.context.view_layer.objects.active = capture
        solid.select_set(True)
    assert bpy.ops.frog.add_crop(shape=shape) == {"FINISHED"}
    settings = capture.frog_edits.crops[0]
    settings.feather, crop = feather, settings.object
    crop.parent, crop.matrix_parent_inverse, crop.rotation_euler = capture, np.eye(4).tolist(), (0.4, 0.2, 0.1)
    size, plain = np.array((0.9, 0.7, 0.8)), ScenePlayer.load(playback.file_of(capture)).at_frame(3).opacities.sum()
    for keep in ("INSIDE", "OUTSIDE"):
        settings.keep, crop.scale = keep, size
        bpy.context.view_layer.update()
        expected, tinted = playback.scene_time(capture, 4).gaussians().opacities, tint(capture, monkeypatch)
        assert 0.05 < expected.sum() / plain < 0.95
        for signs in ((-1, 1, 1), (-1, -1, 1), (-1, -1, -1)):
            crop.scale = size * signs
            bpy.context.view_layer.update()
            shown = playback.scene_time(capture, 4).gaussians()
            np.testing.assert_allclose(shown.opacities, expected, rtol=0, atol=1e-5)
            np.testing.assert_allclose(tint(capture, monkeypatch), tinted, rtol=0, atol=1e-5)
            empty.frame_set(4)
            assert_points_are_what_is_rendered(capture, 4)
            bpy.ops.frog.save_edits(filepath=str(tmp_path / "mirrored.edits.json"))
            loaded = load_edits(tmp_path / "mirrored.edits.json")
            assert_same(edited(ScenePlayer.load(playback.file_of(capture)), loaded)[0].at_frame(3), shown)


@pytest.mark.parametrize("by_field", [True, False])
def test_a_crop_that_is_removed_leaves_its_mesh_as_it_was_and_the_capture_selected(empty, capture, by_field):
    bpy.ops.mesh.primitive_cube_add()
    solid = bpy.context.object
    if by_field:
        capture.frog_edits.crops.add().object = solid
    else:
        bpy.context.view_layer.objects.active = capture
        bpy.ops.frog.add_crop(shape="OBJECT")
    assert solid.display_type == "WIRE" and solid.hide_render, "its faces would cover what it keeps"
    assert bpy.ops.frog.remove_crop() == {"FINISHED"}
    assert solid.display_type == "TEXTURED" and not solid.hide_render
    assert bpy.ops.frog.add_crop(shape="BOX") == {"FINISHED"} == bpy.ops.frog.remove_crop()
    assert bpy.context.object == capture.parent and capture.select_get()


def tint(capture, monkeypatch):
    """(N, 3) the colours of a capture while its crop is transformed."""
    capture.frog_edits.crops[0].object.select_set(True)
    with monkeypatch.context() as patch:
        patch.setattr(edits, "is_transforming", lambda: True)
        patch.setattr(playback, "later", lambda *_: None)
        return playback.displayed(capture, 4).gaussians().sh[:, 0]


def test_the_panel_counts_what_a_crop_shows_at_this_frame(empty, capture, path):
    whole = ScenePlayer.load(path)
    assert "200 Gaussians" in panel_says(captures_panel.FROG_PT_captures)
    crop = cropped(capture, scale=0.3)
    counts = []
    for frame in (1, 10):
        empty.frame_set(frame)
        inside = np.abs((whole.at_frame(frame - 1).means - crop.location) / np.array(crop.scale)).max(1) <= 1
        counts.append(np.count_nonzero(inside))
        assert f"{counts[-1]} Gaussians at this frame" in panel_says(captures_panel.FROG_PT_captures)
    assert 0 < counts[0] != counts[1] and point_cloud.count(capture) > max(counts)


def test_a_linked_duplicate_that_shows_another_frame_has_its_own_points(empty, capture):
    same, later = capture.copy(), capture.copy()
    for other in (same, later):
        empty.collection.objects.link(other)
    empty.frame_set(4)
    assert same.data == later.data == capture.data, "what shows the same is kept once"
    later.frog.start_frame = 3
    assert same.data == capture.data != later.data
    for frame in (4, 7):
        empty.frame_set(frame)
        for obj in (capture, same, later):
            assert_points_are_what_is_rendered(obj, frame)
    later.frog.start_frame = capture.frog.start_frame
    same.frog_edits.grade.opacity = 0.5
    assert same.data != capture.data
    assert_points_are_what_is_rendered(same, 7)
    assert_points_are_what_is_rendered(capture, 7)


def test_a_crop_scaled_to_nothing_says_so_and_loses_nothing(empty, capture):
    crop = cropped(capture, scale=0.5)
    before, size = point_cloud.read(capture)["radiance:base"], crop.scale.copy()
    crop.scale.y = 0.0
    bpy.context.view_layer.update()
    sentence = f"{crop.name}: found a crop scaled to nothing along an axis, expected a box, a sphere or a closed mesh"
    assert sentence in panel_says(edit_panel.FROG_PT_edit)
    refused("scaled to nothing", playback.scene_time, capture, 1)
    np.testing.assert_array_equal(point_cloud.read(capture)["radiance:base"], before)
    crop.scale = size
    bpy.context.view_layer.update()
    assert sentence not in panel_says(edit_panel.FROG_PT_edit)
    np.testing.assert_array_equal(point_cloud.read(capture)["radiance:base"], before)


def test_crops_beside_the_capture_crop_where_they_stand(empty, capture):
    bpy.ops.object.empty_add(type="CUBE", location=(0.4, 0.0, 0.0))
    crop = bpy.context.object
    crop.empty_display_size = 0.5
    capture.parent.location = (3.0, 0.0, 0.0)
    capture.parent.rotation_euler = (0.0, 0.0, 0.7)
    capture.frog_edits.crops.add().object = crop
    bpy.context.view_layer.update()
    empty.frame_set(3)
    gaussians = playback.scene_time(capture, 3).gaussians()
    world = gaussians.means @ np.array(capture.matrix_world)[:3, :3].T + np.array(capture.matrix_world)[:3, 3]
    inside = (np.abs(world - (0.4, 0.0, 0.0)) <= 0.5).all(1)
    np.testing.assert_array_equal(gaussians.opacities > 0, inside & (gaussians.opacities > 0))
    crop.location.x += 3.0
    bpy.context.view_layer.update()
    assert np.count_nonzero(playback.scene_time(capture, 3).gaussians().opacities) > 10
    assert_points_are_what_is_rendered(capture, 3)
    before = point_cloud.read(capture)["radiance:base"]
    capture.parent.location.x += 0.3
    bpy.context.view_layer.update()
    assert_points_are_what_is_rendered(capture, 3)
    assert not np.array_equal(before, point_cloud.read(capture)["radiance:base"])


def test_each_duplicate_of_a_capture_has_its_own_edits(empty, tmp_path):
    for index in range(2):
        path = write_scene(tmp_path / f"{index}.frog", rig_of_three(), count=200, seed=index)
        bpy.ops.import_scene.frog(filepath=str(path))
        active_capture(bpy.context).frog_edits.grade.exposure = 1.0 - 2.0 * index
        instance_in(empty.collection, empty.collection.children[str(index)], (50.0, 0.0, 0.0))
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    captures = visible_captures(depsgraph)
    assert len(captures) == 4
    shown = []
    for obj, evaluated, _ in captures:
        assert evaluated.original == obj and evaluated.frog_edits.grade.exposure == obj.frog_edits.grade.exposure
        shown.append(playback.scene_time(obj, 1).gaussians().sh)
    np.testing.assert_array_equal(gather(depsgraph)[0].sh, np.concatenate(shown))


def test_an_object_that_cannot_crop_is_said_and_stops_a_render(capture):
    mesh = bpy.data.meshes.new("open")
    faces = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (0, 2, 3)]
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [], faces)
    capture.frog_edits.crops.add().object = bpy.data.objects.new("open", mesh)
    refused("open: found a mesh with open borders", lambda: playback.scene_time(capture, 1).gaussians())


def test_edits_are_saved_loaded_copied_and_appended(empty, capture, tmp_path):
    edit_everything(capture)
    expected = playback.scene_time(capture, 4).gaussians()
    copy = capture.copy()
    empty.collection.objects.link(copy)
    copy.location.x += 5.0
    bpy.context.view_layer.update()
    assert_same(playback.scene_time(copy, 4).gaussians(), expected)
    bpy.data.objects.remove(copy)
    blend = tmp_path / "edited.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    assert_same(playback.scene_time(active_capture(bpy.context), 4).gaussians(), expected)
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(blend)) as (there, here):
        here.objects = [name for name in there.objects if name.endswith("Gaussians")]
    assert_same(playback.scene_time(here.objects[0], 4).gaussians(), expected)


def test_a_file_that_cannot_be_loaded_changes_nothing(capture, tmp_path):
    edit_everything(capture)
    before, objects = edits.edits_of(capture), set(bpy.data.objects)
    path = tmp_path / "two.edits.json"
    path.write_text('{"frog_edits": 1, "grades": [{"exposure": 1}, {"exposure": 2}]}')
    refuses("found 2 grades of the whole capture", bpy.ops.frog.load_edits, filepath=str(path))
    assert edits.edits_of(capture) == before and set(bpy.data.objects) == objects


def test_loading_removes_the_crops_that_are_the_captures_alone(empty, capture, tmp_path):
    path = tmp_path / "none.edits.json"
    path.write_text('{"frog_edits": 1}')
    bpy.ops.frog.add_crop(shape="BOX")
    bpy.ops.frog.add_crop(shape="SPHERE")
    bpy.ops.mesh.primitive_cube_add()
    own, (shared, mine) = bpy.context.object, [crop.object for crop in capture.frog_edits.crops]
    own.parent = capture
    capture.frog_edits.crops.add().object = own
    bpy.context.view_layer.objects.active = capture
    other = capture.copy()
    empty.collection.objects.link(other)
    other.frog_edits.crops.remove(1)
    names = [mine.name, shared.name, own.name]
    assert bpy.ops.frog.load_edits(filepath=str(path)) == {"FINISHED"}
    assert not capture.frog_edits.crops and [name in bpy.data.objects for name in names] == [False, True, True]


def test_marks_of_an_earlier_training_are_said_and_dropped(empty, capture, path, capsys):
    bpy.ops.frog.select_gaussians(by="SIZE", size=0.42)
    bpy.ops.frog.hide_gaussians()
    assert point_cloud.count(capture) < 200
    write_scene(path, rig_of_three(), count=200, seed=3)
    empty.frame_set(2)
    assert point_cloud.count(capture) == 200
    assert "another training" in capsys.readouterr().err


def test_every_criterion_selects_what_it_says(capture, path):
    scene = ScenePlayer.load(path)
    for by in ("OPACITY", "SIZE", "DISTANCE", "CAMERAS", "CLUSTER", "DYNAMIC", "STATIC", "HIDDEN"):
        assert bpy.ops.frog.select_gaussians(by=by) == {"FINISHED"}
    bpy.ops.frog.select_gaussians(by="DYNAMIC")
    assert edits.marks_of(capture.frog_edits.selection).number() == scene.num_dynamic
    bpy.ops.frog.select_gaussians_all(action="INVERT")
    assert edits.marks_of(capture.frog_edits.selection) is None
    some = np.arange(200) < 30
    edits.store_marks(capture.frog_edits.selection, Marks.of(scene, some))
    bpy.ops.frog.select_gaussians(by="SIZE", size=0.3, mode="INTERSECT")
    inside = edits.marks_of(capture.frog_edits.selection).chosen()
    assert 0 < inside.sum() < 30 and not inside[30:].any()
    bpy.ops.frog.hide_gaussians(unselected=True)
    assert point_cloud.count(capture) == inside.sum()
    bpy.ops.frog.select_gaussians_all(action="NONE")
    bpy.ops.frog.restore_gaussians()
    assert point_cloud.count(capture) == 200


def test_clean_up_is_worked_out_beside_the_main_thread(capture, path, monkeypatch):
    expected = clean_up(ScenePlayer.load(path), 1.0).hidden
    monkeypatch.setattr(edit_clean, "clean_up", threaded := MagicMock(wraps=clean_up))
    capture.frog_edits.clean_strength = 1.0
    assert bpy.ops.frog.clean_up() == {"FINISHED"}
    marks = edits.marks_of(capture.frog_edits.hidden)
    np.testing.assert_array_equal(np.zeros(200, bool) if marks is None else marks.chosen(), expected)
    assert threaded.call_count == 1 and not SceneWork.is_any_running()


def test_growing_is_worked_out_beside_the_main_thread_and_shrinking_as_well(capture, path, monkeypatch):
    scene = ScenePlayer.load(path)
    chosen = selections.by_distance(scene, np.zeros(3), 1.0)
    asked = MagicMock(side_effect=lambda *given: threads.append(threading.current_thread()) or selections.grown(*given))
    threads = []
    monkeypatch.setattr(edit_clean, "grown", asked)
    capture.frog_edits.grow_distance = 0.2
    for shrink in (False, True):
        bases.select(capture, chosen)
        assert bpy.ops.frog.grow_selection(shrink=shrink) == {"FINISHED"}
        expected = selections.grown(scene, chosen ^ shrink, 0.2) ^ shrink
        np.testing.assert_array_equal(edits.marks_of(capture.frog_edits.selection).chosen(), expected)
    assert len(threads) == 2 and threading.main_thread() not in threads


def test_the_redo_panel_offers_nothing_that_is_worked_out_again():
    """It would be worked out on the main thread, at each change."""
    assert len(WorkedOutEdit.__subclasses__()) == 4
    for kind in WorkedOutEdit.__subclasses__():
        assert ("REGISTER" in kind.bl_options) == (kind is edit_clean.FROG_OT_select_gaussians)


def test_clusters_are_found_once_for_all_limits(capture, monkeypatch):
    monkeypatch.setattr(selections, "clusters", sought := MagicMock(wraps=selections.clusters))
    for members in (2, 10, 200):
        assert bpy.ops.frog.select_gaussians(by="CLUSTER", members=members) == {"FINISHED"}
    assert sought.call_count == 3, "at three times, for whichever limit"


def test_what_is_worked_out_has_one_bar_and_can_be_stopped(capture, path):
    asked, fractions = threading.Event(), []

    def tell(stage, part):
        task._tell(stage, part)
        asked.set()

    scene = ScenePlayer.load(path)
    task = SceneWork(lambda _: [clean_up(scene, 1.0, None, tell) for _ in range(1000)], CLEANING)
    task.begin()
    assert asked.wait(20.0)
    refuses("being worked out", bpy.ops.frog.clean_up)
    while len(fractions) < 3:
        task.pump()
        fractions.append(task.standing.fraction)
    said = panel_says(edit_panel.FROG_PT_clean)
    assert "frog.cancel_edit" in said and "frog.clean_up" not in said and fractions == sorted(fractions)
    assert bpy.ops.frog.cancel_edit() == {"FINISHED"} and finish(task).is_cancelled
    assert "frog.clean_up" in panel_says(edit_panel.FROG_PT_clean)
    assert edits.marks_of(capture.frog_edits.hidden) is None


def test_no_button_moves_under_the_mouse_when_something_is_selected(capture):
    before = panel_says(edit_panel.FROG_PT_clean)
    assert bpy.ops.frog.select_gaussians_all(action="ALL") == {"FINISHED"}
    after = panel_says(edit_panel.FROG_PT_clean)
    assert after != before and re.sub(r"[\d,]+", "", after) == re.sub(r"[\d,]+", "", before)
