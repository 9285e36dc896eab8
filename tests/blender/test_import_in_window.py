"""Other programs' files in a window: converted while the user goes on, stopped by Esc, added when they are there."""

import threading

import bpy
import pytest
from support.blender_windows import in_window
from support.builders import refuses

from frog_blender import unsaved_changes
from frog_blender.engine.interchange import imports
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.operators.import_ply import FROG_OT_import_splats
from frog_blender.timeline import playback

PATIENCE = 60.0  # seconds


@pytest.fixture
def importing(empty, static_rig, tmp_path, monkeypatch):
    """A function that begins an import of files, each of which waits after a quarter of its work for its gate."""
    names, whole = ("a{b}.ply", "second.ply"), imports.import_scene
    gates, begun = ({name: threading.Event() for name in names} for _ in range(2))
    for name in names:
        write_frame(tmp_path / name, ScenePlayer.load(static_rig).at_frame(0))

    def slow(source, target, *, progress, **options):
        progress(1, 4)
        begun[source.name].set()
        assert gates[source.name].wait(PATIENCE)
        progress(2, 4)
        return whole(source, target, progress=progress, **options)

    monkeypatch.setattr(imports, "import_scene", slow)

    def begin(count=1, **options):
        window.said.clear()
        paths = [tmp_path / name for name in names[:count]]
        files = {"directory": str(tmp_path), "files": [{"name": name} for name in names]} if count > 1 else {}
        options |= files or {"filepath": str(paths[0])}
        assert bpy.ops.import_scene.frog_splats(**options) == {"RUNNING_MODAL"}
        window.begun, window.gate, window.path = begun, gates[names[0]], paths[0]
        assert window.send() == {"PASS_THROUGH"} and begun[names[0]].wait(PATIENCE)
        return window

    with in_window(FROG_OT_import_splats) as window:
        yield begin
        for gate in gates.values():
            gate.set()


def finish(running):
    running.gate.set()
    return running.send_until()


def captures():
    return list(playback.captures(bpy.data.objects))


def worker():
    return next((thread for thread in threading.enumerate() if thread.name == "FRoG import"), None)


def test_one_goes_on_until_it_is_there(importing):
    running = importing()
    for _ in range(3):
        assert running.send() == {"PASS_THROUGH"} and not captures()
    assert running.operator.doing == "Importing a{{b}}.ply: 25%"
    bpy.ops.mesh.primitive_cube_add()
    assert finish(running) == {"FINISHED"}
    (capture,) = captures()
    assert capture.frog.filepath == str(running.path.with_suffix(".frog"))
    assert running.said == [("INFO", f"Imported 60 Gaussians to {running.path.with_suffix('.frog')}.")]
    assert bpy.context.scene.objects.get("Cube") is not None and running.operator.timer is None


def test_esc_stops_it_and_nothing_is_written(importing):
    running = importing()
    assert running.send("RIGHTMOUSE", "PRESS") == {"PASS_THROUGH"}, "one works with the mouse meanwhile"
    thread = worker()
    assert running.send("ESC", "PRESS") == {"CANCELLED"} and running.operator.timer is None
    running.gate.set()
    thread.join(PATIENCE)
    assert not thread.is_alive() and not captures() and not list(running.path.parent.glob("a*.frog"))
    assert running.said == [("INFO", "The import was stopped.")]


def test_a_scene_that_is_edited_gets_it_afterwards(importing):
    running = importing()
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.mode_set(mode="EDIT")
    running.gate.set()
    running.send_until(lambda: "Object Mode" in running.operator.doing)
    assert running.path.with_suffix(".frog").is_file() and not captures()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert running.send() == {"FINISHED"} and len(captures()) == 1


def test_a_scene_that_is_gone_gets_nothing_and_the_turn_is_told(importing):
    running = importing()
    asked = bpy.context.scene
    bpy.context.window.scene = bpy.data.scenes.new("Another")
    bpy.data.scenes.remove(asked)
    assert finish(running) == {"CANCELLED"} and not captures()
    ((kind, sentence),) = running.said
    assert kind == "ERROR" and "not open any more" in sentence and "-90 degrees about the global X axis" in sentence


def test_only_one_at_a_time(importing):
    running = importing()
    refuses("Another import is running", importing)
    thread = worker()
    assert running.send("ESC", "PRESS") == {"CANCELLED"}
    refuses("has not ended yet", importing)
    running.gate.set()
    thread.join(PATIENCE)
    again = importing()
    assert finish(again) == {"FINISHED"} and len(captures()) == 1


@pytest.mark.parametrize("given", [{}, {"set_up_scene": True}], ids=["by itself", "asked for"])
def test_what_was_changed_meanwhile_stays(importing, given):
    scene = bpy.context.scene
    running = importing(**given)
    assert running.operator.set_up_scene
    bpy.ops.mesh.primitive_cube_add()
    scene.render.resolution_x = 1234
    before, world = scene.render.engine, scene.world
    assert finish(running) == {"FINISHED"} and len(captures()) == 1
    assert ((scene.render.engine, scene.world) == (before, world)) == (not given)
    assert (scene.render.engine == "FROG") == bool(given)


def test_stopped_after_the_first_of_several_it_can_be_undone(importing):
    running = importing(2)
    running.gate.set()
    running.send_until(running.begun["second.ply"].is_set)
    assert len(captures()) == 1 and unsaved_changes.is_being_changed()
    assert running.send("ESC", "PRESS") == {"FINISHED"}
    ((kind, sentence),) = running.said
    assert kind == "INFO" and sentence.startswith("The import was stopped. Imported 60 Gaussians to ")
