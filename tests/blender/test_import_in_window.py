"""Other programs' files in a window: converted while the user goes on, stopped by Esc, added when they are there."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import bpy
import pytest
from support.blender_windows import drop_operators, event, in_window

from frog_blender.engine.interchange import imports
from frog_blender.engine.interchange.ply import write_splats
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.operators.import_ply import FROG_OT_import_splats
from frog_blender.timeline import playback

PATIENCE = 120.0  # seconds


@pytest.fixture
def importing(empty, static_rig, tmp_path, monkeypatch):
    """A function that begins an import that waits after a quarter of its work until its gate opens."""
    path, gate, begun, whole = tmp_path / "a{b}.ply", threading.Event(), threading.Event(), imports.import_scene
    write_splats(path, ScenePlayer.load(static_rig).at_frame(0))

    def slow(source, target, *, progress, **options):
        progress(1, 4)
        begun.set()
        assert gate.wait(PATIENCE)
        progress(2, 4)
        return whole(source, target, progress=progress, **options)

    monkeypatch.setattr(imports, "import_scene", slow)

    def begin():
        window.said.clear()
        assert bpy.ops.import_scene.frog_splats(filepath=str(path)) == {"RUNNING_MODAL"}
        operator, steps = window.started[-1]
        running = SimpleNamespace(operator=operator, steps=steps, said=window.said, gate=gate, path=path)
        assert send(running) == {"PASS_THROUGH"} and begun.wait(PATIENCE)
        return running

    with in_window(FROG_OT_import_splats) as window:
        yield begin
        gate.set()


def send(running, kind="TIMER", value="NOTHING"):
    return running.operator.modal(bpy.context, event(kind, value))


def finish(running):
    """Sends events until the operator ends."""
    running.gate.set()
    while (result := send(running)) == {"PASS_THROUGH"}:
        pass
    return result


def captures():
    return list(playback.captures(bpy.data.objects))


def worker():
    return next((thread for thread in threading.enumerate() if thread.name == "FRoG import"), None)


def test_one_goes_on_until_it_is_there(importing):
    running = importing()
    for _ in range(3):
        assert send(running) == {"PASS_THROUGH"} and not captures()
    assert running.operator.doing == "Importing a{{b}}.ply: 25%"
    bpy.ops.mesh.primitive_cube_add()
    assert finish(running) == {"FINISHED"}
    (capture,) = captures()
    assert capture.frog.filepath == str(running.path.with_suffix(".frog"))
    assert running.said == [("INFO", f"Imported 60 Gaussians to {running.path.with_suffix('.frog')}.")]
    assert bpy.context.scene.objects.get("Cube") is not None and running.operator.timer is None


def test_esc_stops_it_and_nothing_is_written(importing):
    running = importing()
    assert send(running, "RIGHTMOUSE", "PRESS") == {"PASS_THROUGH"}, "one works with the mouse meanwhile"
    thread = worker()
    assert send(running, "ESC", "PRESS") == {"CANCELLED"} and running.operator.timer is None
    running.gate.set()
    thread.join(PATIENCE)
    assert not thread.is_alive() and not captures() and not list(running.path.parent.glob("a*.frog"))
    assert running.said == [("INFO", "The import was stopped.")]


def test_another_file_ends_it(importing):
    running = importing()
    thread = worker()
    drop_operators()
    running.gate.set()
    thread.join(PATIENCE)
    assert not thread.is_alive() and running.steps.gi_frame is None and not list(running.path.parent.glob("a*.frog"))


def test_a_scene_that_is_edited_is_left_alone(importing):
    running = importing()
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.mode_set(mode="EDIT")
    assert finish(running) == {"CANCELLED"} and not captures()
    ((kind, sentence),) = running.said
    assert kind == "ERROR" and "written, but not added, because the scene is being edited" in sentence
    assert running.path.with_suffix(".frog").is_file()
    bpy.ops.object.mode_set(mode="OBJECT")
