"""Export of several frames in a window: one at a time, stopped by Esc, and at an end whatever happens meanwhile.

The operator, its files and the window manager are Blender's own; only the events come from here, since nothing else
sends any without a screen.
"""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from support.blender_windows import event, in_window

from frog_blender.engine.interchange.ply import read_splats
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.operators.export_scene import FROG_OT_export_frames
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.timeline import playback


@pytest.fixture
def export(empty, static_rig, tmp_path):
    """A function that begins an export of frames 1 to 10 as the file browser does, and gives the running operator."""
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    empty.frame_set(4)

    def begin(**options):
        window.said.clear()
        assert bpy.ops.export_scene.frog_frames(
            filepath=str(tmp_path / "out" / "x.ply"), frames="SCENE", **options
        ) == {"RUNNING_MODAL"}
        operator, steps = window.started[-1]
        return SimpleNamespace(operator=operator, steps=steps, said=window.said, folder=tmp_path / "out")

    with in_window(FROG_OT_export_frames) as window:
        yield begin


def send(running, kind="TIMER", times=1, value="NOTHING"):
    for _ in range(times):
        result = running.operator.modal(bpy.context, event(kind, value))
    return result


def written(running):
    """Names of the files, each of which can be read."""
    found = sorted(path for path in running.folder.glob("*")) if running.folder.is_dir() else []
    assert all(len(read_splats(path).arrays["means"]) == 60 for path in found)
    return [path.name for path in found]


def is_over(running):
    return running.operator.timer is None and running.steps.gi_frame is None


def test_a_frame_each_time_until_all_are_there(empty, export, static_rig):
    running = export(apply_transform=False)
    assert written(running) == []
    for done in range(1, 11):
        assert send(running) == {"PASS_THROUGH"} and len(written(running)) == done
        assert send(running, "MOUSEMOVE") == {"PASS_THROUGH"} and len(written(running)) == done
    assert send(running) == {"FINISHED"} and is_over(running)
    assert running.said == [("INFO", f"10 files written to {running.folder}.")]
    means = read_splats(running.folder / "x_0007.ply").arrays["means"]
    np.testing.assert_array_equal(means, ScenePlayer.load(static_rig).at_frame(6).means)
    assert empty.frame_current == 4


def test_it_is_stopped_and_files_stay(empty, export):
    running = export(apply_transform=True)
    send(running, times=3)
    assert empty.frame_current == 3
    assert send(running, "RIGHTMOUSE", value="RELEASE") == {"PASS_THROUGH"}, "of a key that was pressed before"
    assert send(running, "RIGHTMOUSE", value="PRESS") == {"CANCELLED"} and is_over(running)
    assert written(running) == ["x_0001.ply", "x_0002.ply", "x_0003.ply"] and empty.frame_current == 4
    assert running.said == [("INFO", f"The export was stopped. 3 of 10 files were written to {running.folder}.")]
    assert send(running) == {"CANCELLED"} and len(written(running)) == 3, "a late event does nothing"


def test_an_error_in_the_middle_ends_it_in_a_sentence(empty, export):
    running = export()
    send(running, times=2)
    (running.folder / "x_0003.ply").mkdir()  # where the next file goes
    assert send(running) == {"CANCELLED"} and is_over(running)
    (running.folder / "x_0003.ply").rmdir()
    assert len(written(running)) == 2
    ((kind, text),) = running.said
    assert kind == "ERROR" and "x_0003.ply" in text and text.count(". ") == 0
    assert text.endswith(f"2 of 10 files were written to {running.folder}.")


def test_the_capture_is_deleted_meanwhile(empty, export):
    running = export(apply_transform=True)
    send(running, times=2)
    name = active_capture(bpy.context).name
    bpy.data.objects.remove(next(playback.captures(empty.objects)))
    assert send(running) == {"CANCELLED"} and is_over(running) and len(written(running)) == 2
    ((kind, text),) = running.said
    assert kind == "ERROR" and text.startswith(f"{name}: this capture is no longer in the file; 2 of 10 files")
    assert empty.frame_current == 4


def test_another_scene_is_shown_then_the_first_is_deleted(empty, export, static_rig):
    running = export(apply_transform=True, y_down=False)
    send(running, times=2)
    bpy.context.window.scene = bpy.data.scenes.new("Other")
    assert send(running) == {"PASS_THROUGH"}
    means = read_splats(running.folder / "x_0003.ply").arrays["means"]
    np.testing.assert_allclose(means, ScenePlayer.load(static_rig).at_frame(2).means, atol=1e-6)
    capture = next(playback.captures(empty.objects))
    bpy.context.scene.collection.objects.link(capture)  # or it would go with its scene
    bpy.data.scenes.remove(empty)
    assert send(running) == {"CANCELLED"} and is_over(running) and len(written(running)) == 3
    assert "its scene was deleted during the export" in running.said[0][1]


def test_one_frame_and_a_repetition_are_written_at_once(empty, export, tmp_path, monkeypatch):
    assert bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "now.ply"), frames="CURRENT") == {"FINISHED"}
    running = export()
    assert running.operator.execute(bpy.context) == {"FINISHED"}, "Repeat Last comes to the same operator again"
    assert len(written(running)) == 10
    bpy.data.objects.remove(next(playback.captures(bpy.context.scene.objects)))
    assert running.operator.execute(bpy.context) == {"CANCELLED"}, "it was deleted while the file browser was open"
