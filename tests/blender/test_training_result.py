"""What becomes of a training's scene in Blender: it joins the scene that asked for it and changes nothing else."""

import bpy
import pytest
from support.builders import refuses
from support.small_scenes import rig_of_three, write_scene
from support.training_panel import panel_says, told
from support.users_scene import users_scene, views

from frog_blender.engine.training.session import events
from frog_blender.operators.train import ResultImporter
from frog_blender.scene_import.capture_objects import that_plays
from frog_blender.scene_import.scene_setup import start_cube, values
from frog_blender.tasks.background_task import Ended
from frog_blender.tasks.training import TrainingTask
from frog_blender.timeline import open_scenes, playback
from frog_blender.ui import train_panel


def files(scene):
    return [playback.file_of(obj).name for obj in playback.captures(scene.objects)]


def drawn():
    return panel_says(train_panel.FROG_PT_train)


@pytest.mark.parametrize("is_new", [True, False], ids=["a new file", "a scene of the user's"])
def test_a_training_that_ends_changes_nothing_but_adds_its_scene(request, static_rig, is_new):
    scene = request.getfixturevalue("new_file" if is_new else "empty")
    if not is_new:
        users_scene(scene)
        mine = bpy.data.objects.new("Mine", None)
        scene.collection.objects.link(mine)
        mine.select_set(True)
        bpy.context.view_layer.objects.active = mine
    before, shading = values(scene), [view.shading.type for view in views()]
    selected, active = bpy.context.selected_objects, bpy.context.object
    collections = [collection.name for collection in scene.collection.children]
    assert ResultImporter(scene)(static_rig) == ""
    assert files(scene) == ["figure.frog"] and values(scene) == before
    assert [view.shading.type for view in views()] == shading
    assert bpy.context.selected_objects == selected and bpy.context.object == active
    assert [collection.name for collection in scene.collection.children] == [*collections, "figure"]


def test_one_click_shows_it_and_one_question_sets_the_scene_up(new_file, static_rig):
    scene = new_file
    ResultImporter(scene)(static_rig)
    assert bpy.ops.frog.show_result(filepath=str(static_rig)) == {"FINISHED"}
    assert scene.camera.name == "cam00", "nobody chose the camera of the new file"
    assert {obj.name for obj in bpy.context.selected_objects} == {"figure", "figure Gaussians"}
    scene.camera.location.x += 1.0
    chosen = scene.camera
    assert bpy.ops.frog.show_result(filepath=str(static_rig)) == {"FINISHED"} and scene.camera == chosen
    assert (scene.frame_end, scene.render.engine != "FROG") == (250, True)
    assert bpy.ops.frog.set_up_scene(use_engine=False, use_colors=False, use_frames=False) == {"FINISHED"}
    assert (scene.frame_end, scene.render.resolution_x) == (250, 96) and scene.render.engine != "FROG"
    assert scene.view_settings.view_transform == "AgX" and start_cube(scene) is not None
    assert bpy.ops.frog.set_up_scene() == {"FINISHED"}
    assert (scene.frame_end, scene.render.engine, scene.view_settings.view_transform) == (10, "FROG", "Standard")
    assert start_cube(scene) is None and scene.objects["Cube"].hide_render, "it would stand in the picture"


def test_the_finished_scene_is_read_where_it_was_trained(empty, static_rig):
    finished = events.Finished(str(static_rig), 9, 1.0, 20.0, 5)
    task = TrainingTask(lambda control: iter([finished]), ResultImporter(empty)).start()
    assert task.join(20.0) and static_rig in open_scenes.paths() and not files(empty)
    task.pump_all()
    assert files(empty) == ["figure.frog"]


def test_what_cannot_be_shown_is_said(empty, static_rig):
    refuses("Import it first", bpy.ops.frog.show_result, filepath=str(static_rig))
    ResultImporter(empty)(static_rig)
    obj = next(playback.captures(empty.objects))
    layers = [bpy.context.view_layer.layer_collection]
    for layer in layers:
        layers += layer.children
    for layer in layers[1:]:
        layer.exclude = layer.collection in obj.users_collection
    refuses("excluded from this view layer", bpy.ops.frog.show_result, filepath=str(static_rig))


def test_a_result_can_be_shown_and_a_changed_cube_is_the_users(new_file, static_rig):
    scene = new_file
    ResultImporter(scene)(static_rig)
    told(events.Finished(str(static_rig), 9, 1.0, 20.0, 5), Ended(""))
    assert {"frog.show_result", "frog.set_up_scene"} <= set(drawn().split())
    assert start_cube(scene) is not None
    scene.objects["Cube"].location.z = 1.0
    assert start_cube(scene) is None, "one that was changed is the user's"


def test_one_undo_takes_it_back(empty, static_rig):
    users_scene(empty)
    bpy.ops.ed.undo_push(message="Mine")
    before = {path: getattr(value, "name", value) for path, value in values(empty).items()}
    ResultImporter(empty)(static_rig)
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert not files(scene) and not bpy.data.cameras and bpy.data.worlds["My studio lights"].users == 1
    assert {path: getattr(value, "name", value) for path, value in values(scene).items()} == before


def test_what_is_being_edited_is_left_to_the_panel(new_file, static_rig):
    scene = new_file
    bpy.context.view_layer.objects.active = cube = bpy.data.objects["Cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    before = values(scene)
    assert "being edited" in ResultImporter(scene)(static_rig)
    assert not files(scene) and values(scene) == before and cube.mode == "EDIT"


def test_another_file_gets_nothing_and_the_same_one_opened_again_gets_it(empty, static_rig, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    show = ResultImporter(bpy.context.scene)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    said = show(static_rig)
    assert "was not open" in said and said.endswith("when the training ended.")
    assert not bpy.data.objects and not bpy.data.collections
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mine.blend"))
    show(static_rig)
    assert files(bpy.context.scene) == ["figure.frog"]


def test_two_trainings_of_one_capture_are_told_apart(empty, tmp_path):
    for name in ("room.frog", "room_2.frog"):
        write_scene(tmp_path / name, rig_of_three(), capture_path="/film/room")
    assert ResultImporter(empty)(tmp_path / "room.frog") == ""
    assert "beside room.frog of the same capture" in ResultImporter(empty)(tmp_path / "room_2.frog")
    assert ResultImporter(empty)(tmp_path / "room_2.frog") == ""
    assert sorted(files(empty)) == ["room.frog", "room_2.frog"], "what plays it already shows it"
    assert empty.frame_end == 250


@pytest.mark.parametrize("cancelled", [False, True])
def test_the_panel_offers_what_is_not_here(empty, static_rig, cancelled):
    users_scene(empty)
    path = str(static_rig)
    event = events.Cancelled(9, path) if cancelled else events.Finished(path, 9, 1.0, 20.0, 5)
    task = told(event, Ended(""))
    task.note = "Not imported by itself: the scene was being edited when the training ended."
    assert "import_scene.frog" in drawn() and task.note in drawn() and "frog.set_up_scene" not in drawn()
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    assert that_plays(empty, static_rig)
    assert "import_scene.frog" not in drawn() and "frog.set_up_scene" in drawn()
    assert bpy.ops.frog.set_up_scene() == {"FINISHED"}
    assert "frog.set_up_scene" not in drawn()
