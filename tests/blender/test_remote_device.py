"""The device Remote: what the panel says of it, and a training by a command that ends in an imported scene."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from support.builders import REPOSITORY
from support.training_panel import Written, finish, panel_says

from frog_blender.engine.training.session import events
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.timeline import playback
from frog_blender.ui import preferences, torch_environment, train_panel

COMMAND = f"{shlex.quote(sys.executable)} -m frog_blender.cli train {{capture}} --out {{output}} --events {{options}}"


@pytest.fixture
def chosen(empty):
    """The add-on's preferences, as in a Blender that has it installed."""
    addon = bpy.context.preferences.addons.new()
    addon.module = torch_environment.base_package
    yield addon.preferences
    background_task.stop()
    TrainingTask.forget()
    bpy.context.preferences.addons.remove(addon)


@pytest.fixture
def capture(tmp_path, monkeypatch):
    """A folder of four filmed cameras."""
    film = pytest.importorskip("support.synthetic_capture")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    return film.write_capture(tmp_path / "capture")


def drawn(scene):
    return panel_says(train_panel.FROG_PT_train, scene=scene)


def preferences_drawn(chosen):
    layout = Written()
    shown = SimpleNamespace(layout=layout, bl_rna=chosen.bl_rna, remote_command=chosen.remote_command)
    torch_environment.TrainingPreferences.draw_remote(shown)
    return layout.said


def test_without_a_command_it_is_grey_and_says_why(chosen, capture, monkeypatch):
    settings = bpy.context.scene.frog
    settings.capture_folder, settings.device = str(capture), "remote"
    assert "Roughly" not in drawn(bpy.context.scene)
    assert "needs a Remote Command" in drawn(bpy.context.scene) and not bpy.ops.frog.train.poll()
    with pytest.raises(RuntimeError, match="needs a Remote Command in the add-on's preferences"):
        bpy.ops.frog.train()
    chosen.remote_command = "frog train {capture}"
    with pytest.raises(RuntimeError, match=r"lacks \{output\} and \{options\}"):
        bpy.ops.frog.train()
    chosen.remote_command = COMMAND
    monkeypatch.setattr(torch_environment, "torch_needed", lambda: "There is no torch.")
    assert bpy.ops.frog.train.poll() and "no torch" not in drawn(bpy.context.scene)
    settings.device = "cpu"
    assert not bpy.ops.frog.train.poll() and "There is no torch." in drawn(bpy.context.scene)


def test_without_preferences_there_is_no_command(empty):
    empty.frog.device = "remote"
    assert "needs a Remote Command" in torch_environment.needed(empty.frog)


def test_the_preferences_say_what_the_command_lacks(chosen):
    assert isinstance(chosen, preferences.FROG_AP_preferences)
    assert preferences_drawn(chosen) == ["remote_command", torch_environment.EXAMPLE]
    chosen.remote_command = torch_environment.EXAMPLE
    assert preferences_drawn(chosen) == ["remote_command", "remote_local_folder", "remote_folder"]
    chosen.remote_folder = "/data"
    assert "both a Local Folder and a Remote Folder" in preferences_drawn(chosen)[-1]


def test_a_training_elsewhere_ends_in_an_imported_scene(chosen, capture, monkeypatch):
    """Here torch is not even looked for."""
    pytest.importorskip("torch")
    scene = bpy.context.scene
    settings = scene.frog
    settings.capture_folder, settings.recipe, settings.device, settings.steps = str(capture), "draft", "remote", 30
    settings.max_gaussians = 250
    chosen.remote_command = COMMAND
    monkeypatch.setattr(torch_environment, "make_torch_importable", lambda: pytest.fail("not needed"))
    seen, take = [], TrainingTask.apply
    monkeypatch.setattr(TrainingTask, "apply", lambda self, event: (seen.append(event), take(self, event)))
    assert bpy.ops.frog.train() == {"FINISHED"}
    task = TrainingTask.current()
    assert "frog.pause_training" in drawn(scene) and "show_live" not in drawn(scene)
    assert task.join(120.0)
    while background_task.tick() is not None:
        pass
    state = task.state
    assert not task.error and not task.note and state.step == 30 and state.psnr and state.preview is not None
    assert state.result == Path(settings.output_path) and state.result_bytes == state.result.stat().st_size
    assert any(isinstance(event, events.Stage) for event in seen) and state.capacity
    assert [playback.file_of(obj) for obj in playback.captures(scene.objects)] == [state.result]
    assert "Finished in" in drawn(scene)


def test_cancelled_from_the_panel_and_trained_on(chosen, capture):
    pytest.importorskip("torch")
    scene = bpy.context.scene
    settings = scene.frog
    settings.capture_folder, settings.recipe, settings.device, settings.steps = str(capture), "draft", "remote", 10**6
    settings.max_gaussians, chosen.remote_command = 250, COMMAND
    assert bpy.ops.frog.train() == {"FINISHED"}
    task = TrainingTask.current()
    while not task.state.step:
        assert background_task.tick() is not None, task.error
    assert bpy.ops.frog.cancel_training() == {"FINISHED"}
    finish(task)
    assert task.is_cancelled and not task.error and task.state.result.is_file()
    assert "Import What There Is" not in drawn(scene) and "frog.train" in drawn(scene)
    settings.steps = task.state.step + 2000  # it was told to the panel a few times a second: more may be done
    assert bpy.ops.frog.train(resume=True) == {"FINISHED"}
    task = finish(TrainingTask.current())
    assert not task.error and task.state.step == settings.steps


def test_what_outlives_its_patience_dies_with_blender(chosen, capture, tmp_path, monkeypatch, capfd):
    script = tmp_path / "deaf.py"
    script.write_text('import time\nprint(\'{"event": "saved", "path": "x"}\', flush=True)\ntime.sleep(100)\n')
    chosen.remote_command = (
        f"{shlex.quote(sys.executable)} {shlex.quote(str(script))} {{capture}} {{output}} {{options}}"
    )
    settings = bpy.context.scene.frog
    settings.capture_folder, settings.device = str(capture), "remote"
    monkeypatch.setattr(TrainingTask, "patience", 0.01)
    monkeypatch.setattr(TrainingTask, "quit_seconds", 0.1)
    assert bpy.ops.frog.train() == {"FINISHED"}
    task = TrainingTask.current()
    while not task.pump():
        pass
    background_task.stop()
    assert "That took longer." in capfd.readouterr().err
    assert task.join(20.0), "it was killed, which ends the worker"
    task.pump_all()
    assert task.is_cancelled and not task.error
