"""What people do to a file: import twice, duplicate, rename, delete, undo, reload scripts or quit while training.
Nothing crashes, no thread stays, no trained scene is lost. And the example that needs no window."""

import shutil
from pathlib import Path

import bpy
import pytest
from support.blender_windows import another_blender, said_by, script
from support.small_scenes import imported, plays, shows

from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.scene_import.capture_objects import cameras_of, select_only
from frog_blender.timeline import playback

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("how", ["imported again", "duplicated with all of it"])
def test_two_captures_move_and_play_by_themselves(empty, capture, static_rig, how):
    if how == "imported again":
        second = imported(static_rig, start_frame=4.0)
        assert len(empty.collection.children) == 2
    else:
        bpy.ops.object.select_all(action="SELECT")
        bpy.ops.object.duplicate()
        second = next(obj for obj in bpy.context.selected_objects if obj in set(playback.captures(empty.objects)))
        second.frog.start_frame = 4.0
    assert second != capture and second.parent != capture.parent and len(cameras_of(second)) == 3
    second.parent.location.x += 3.0
    plays(capture, static_rig, 6)
    shows(second, static_rig, 2.0)
    assert capture.matrix_world.translation.x == 0.0 and second.matrix_world.translation.x == pytest.approx(3.0)


def test_without_its_root_a_capture_plays_on(empty, capture, static_rig):
    select_only(bpy.context, capture.parent)
    bpy.ops.object.delete()
    plays(capture, static_rig, 5)
    assert capture.parent is None and bpy.ops.frog.align_to_floor() == {"FINISHED"}


def names():
    return {block.name for kind in (bpy.data.objects, bpy.data.collections) for block in kind}


@pytest.mark.parametrize("is_clicked", [True, False])
def test_a_deletion_leaves_nothing_but_what_is_the_users_in_one_step(empty, static_rig, is_clicked):
    imported(static_rig)
    bpy.ops.mesh.primitive_cube_add()
    cube, others = bpy.context.object, names()
    obj = imported(static_rig)
    shot, root = cameras_of(obj)[0].copy(), obj.parent
    cameras_of(obj)[0].users_collection[0].objects.link(shot)
    shot.name, cube.parent = "shot", root
    kept = {"shot", *(of.name for part in (shot, root) for of in part.users_collection)}
    bpy.ops.frog.add_crop(shape="BOX")
    select_only(bpy.context, root)
    obj.select_set(is_clicked)
    there = names()
    bpy.ops.ed.undo_push(message="imported")
    assert bpy.ops.frog.delete("EXEC_DEFAULT", True) == {"FINISHED"}
    assert names() == others | kept
    bpy.ops.ed.undo()
    assert names() == there
    bpy.data.objects.remove(bpy.data.objects["shot"])
    assert bpy.ops.frog.delete() == {"FINISHED"} and names() == others
    assert not bpy.ops.frog.delete.poll(), "Blender's own deletes what is no capture"


def test_an_import_and_a_deletion_are_undone_and_done_again(empty, static_rig):
    bpy.ops.ed.undo_push(message="before")
    obj = imported(static_rig)
    obj.name, obj.data.name, obj.parent.name = "a", "b", "c"
    bpy.ops.ed.undo_push(message="imported")
    select_only(bpy.context, obj)
    bpy.ops.object.delete()
    bpy.ops.ed.undo_push(message="deleted")
    for step, is_there in ((bpy.ops.ed.undo, True), (bpy.ops.ed.undo, False), (bpy.ops.ed.redo, True)):
        bpy.context.scene.frame_set(3)
        step()
        bpy.context.scene.frame_set(7)
        assert ("a" in bpy.data.objects) == is_there
        if is_there:
            shows(bpy.data.objects["a"], static_rig, 6.0)
        else:
            assert not bpy.data.cameras and not bpy.data.collections
    bpy.ops.ed.redo()
    bpy.context.scene.frame_set(2)
    assert "a" not in bpy.data.objects


SOURCE = """
import sys, threading
from importlib import import_module
from pathlib import Path
name, scene, marker = sys.argv[-3:]

def events(cancelled):
    kinds = import_module(name + ".engine.training.session.events")
    while not cancelled():
        yield kinds.Stage("decoding", 0, 1)
        threading.Event().wait(0.005)
    threading.Event().wait(0.5)  # a scene is being written
    Path(marker).write_text("saved")
    yield kinds.Cancelled(0, None)
"""

QUIT = (
    SOURCE
    + f"""
sys.path[:0] = [{str(ROOT)!r}]
import frog_blender
from frog_blender.tasks.training import TrainingTask
frog_blender.register()
TrainingTask(events).begin().control.pause()
"""
)

RELOAD = (
    SOURCE
    + """
import bpy, addon_utils
addon_utils.enable(name, default_set=True)
training, point_cloud = (import_module(f"{name}.{room}") for room in ("tasks.training", "point_cloud"))
bpy.ops.import_scene.frog(filepath=scene)
capture = next(child for child in bpy.context.object.children if child.type != "CAMERA")
threads = threading.active_count()
handlers = len(bpy.app.handlers.frame_change_pre)
task = training.TrainingTask(events).begin()
bpy.utils.load_scripts(reload_scripts=True)  # what Reload Scripts does, in a window and without one
print("ended", task.join(0.0) and Path(marker).exists() and threading.active_count() == threads)
print("handlers", len(bpy.app.handlers.frame_change_pre) == handlers)
bpy.context.scene.frame_set(1)
first = point_cloud.read(capture)["position"]
bpy.context.scene.frame_set(6)
print("plays", abs(point_cloud.read(capture)["position"] - first).max() > 1e-3)
print("trains", training.TrainingTask(events).begin().is_running)
addon_utils.disable(name, default_set=True)
"""
)


leaves = pytest.mark.skipif(
    not bpy.app.binary_path and bpy.app.version < (5, 0),
    reason="the bpy 4.5 module never leaves while any script's handler is registered",
)
NAME = "bl_ext.user_default.frog_blender"


@pytest.fixture
def extension(tmp_path):
    """The add-on as an extension in a folder of the user's."""
    folder = tmp_path / "user" / "extensions" / "user_default" / "frog_blender"
    shutil.copytree(ROOT / "frog_blender", folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "blender_manifest.toml", folder)


@leaves
def test_quitting_while_a_training_is_paused_waits_for_what_was_learned(tmp_path):
    said_by(another_blender(script(tmp_path, QUIT), "frog_blender", "none", tmp_path / "marker"), tmp_path)
    assert (tmp_path / "marker").read_text() == "saved"


@leaves
def test_scripts_reloaded_while_training(static_rig, extension, tmp_path):
    """Reload Scripts finds extensions."""
    command = another_blender(script(tmp_path, RELOAD), NAME, static_rig, tmp_path / "marker")
    said = said_by(command, tmp_path)
    for line in ("ended True", "handlers True", "plays True", "trains True"):
        assert line in said, said


ENABLE = f"""
import bpy, addon_utils
addon_utils.enable("{NAME}", default_set=True)
bpy.ops.wm.save_userpref()
"""


@leaves
@pytest.mark.parametrize("has", [pytest.param("nothing", marks=pytest.mark.slow), "extension that is on"])
def test_the_example_without_a_window_trains_and_renders(request, tmp_path, has):
    """With the add-on beside it, and with the extension that a Blender has."""
    pytest.importorskip("torch")
    pytest.importorskip("cv2")
    capture = pytest.importorskip("support.synthetic_capture").write_capture(tmp_path / "capture")
    commands = [another_blender(ROOT / "examples" / "headless.py", capture, tmp_path / "out", "--steps", 4)]
    if not bpy.app.binary_path:
        commands[0][1:1] = ["-P"]  # or the folder beside the script could stand in for the extension
    if has != "nothing":
        request.getfixturevalue("extension")
        commands.insert(0, another_blender(script(tmp_path, ENABLE)))
    for command in commands:
        own = [word for word in command if word != "--factory-startup"]
        said = said_by(own, tmp_path, FROG_CACHE=str(tmp_path / "cache"))
        assert "has been registered before" not in said, said
    scene = read_scene(tmp_path / "out" / "scene.frog").header
    assert len(list((tmp_path / "out" / "frames").iterdir())) == scene.frame_count
    assert scene.recipe["capacity"] == "auto"
