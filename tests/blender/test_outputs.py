"""One capture after another in the panel: each keeps its own scene and its own Resume."""

import bpy
import pytest
from support.small_scenes import rig_of_three, write_scene
from support.training_panel import leave_checkpoint

from frog_blender import addon_state
from frog_blender.engine.errors import FrogError
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.tasks.training_request import can_resume, request_of
from frog_blender.ui import capture_summary


def trained(path, capture):
    """What a training of a folder leaves: a scene and a checkpoint."""
    write_scene(path, rig_of_three(), capture_path=str(capture.resolve()))
    leave_checkpoint(path, capture)


def train():
    """Presses the button. The training itself ends with a sentence, as there is nothing in the capture's folder."""
    pytest.importorskip("torch")
    addon_state.reset(capture_summary.Inspected)  # as in a file that was just opened
    try:
        assert bpy.ops.frog.train() == {"FINISHED"}
        assert TrainingTask.current().join(120.0)
    finally:
        background_task.stop()
        TrainingTask.forget()


@pytest.fixture
def captures(empty, tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
    return tmp_path / "a", tmp_path / "b"


def test_another_capture_gets_another_output_but_a_name_of_ones_own_stays(empty, captures, tmp_path):
    settings, (first, second) = empty.frog, captures
    settings.capture_folder = f"{first}/"
    assert settings.output_path == f"{first}.frog"
    trained(tmp_path / "a.frog", first)
    assert can_resume(settings)
    settings.capture_folder = str(second)
    assert settings.output_path == f"{second}.frog" and not can_resume(settings)
    settings.capture_folder = str(first)
    assert settings.output_path == f"{first}.frog" and can_resume(settings)
    settings.output_path = mine = str(tmp_path / "mine.frog")
    settings.capture_folder = str(second)
    assert settings.output_path == mine


@pytest.mark.parametrize("path", ["/", ".", "//"])
def test_an_output_without_a_name_is_one_sentence(empty, captures, path):
    empty.frog.capture_folder, empty.frog.output_path = str(captures[0]), path
    assert not can_resume(empty.frog)
    with pytest.raises(FrogError, match="expected the name of a"):
        request_of(empty.frog)


def test_what_lies_where_the_name_leads_is_not_written_over(empty, captures, tmp_path):
    first, second = captures
    trained(tmp_path / "b.frog", first)
    empty.frog.capture_folder = str(second)
    assert empty.frog.output_path == str(tmp_path / "b_2.frog")


def test_training_into_another_captures_scene_takes_a_number(empty, captures, tmp_path):
    settings, (first, second) = empty.frog, captures
    trained(tmp_path / "mine.frog", first)
    before = (tmp_path / "mine.frog").read_bytes()
    settings.capture_folder, settings.output_path = str(second), str(tmp_path / "mine.frog")
    assert not can_resume(settings)
    with pytest.raises(RuntimeError, match="found a training of another capture"):
        addon_state.reset(capture_summary.Inspected)
        bpy.ops.frog.train(resume=True)
    train()
    assert settings.output_path == str(tmp_path / "mine_2.frog")
    assert (tmp_path / "mine.frog").read_bytes() == before
    settings.capture_folder, settings.output_path = str(first), str(tmp_path / "mine.frog")
    assert request_of(settings).output == tmp_path / "mine_2.frog", "nor is one's own written over"
    assert can_resume(settings) and request_of(settings, resume=True).output == tmp_path / "mine.frog"


def test_training_again_keeps_an_output_relative(empty, captures, tmp_path, relative_paths):
    """A project that moves goes on beside its .blend, and another capture still changes the output."""
    settings, (first, second) = empty.frog, captures
    settings.capture_folder = str(first)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "project.blend"))
    settings.output_path = settings.derived_output = "//a.frog"
    trained(tmp_path / "a.frog", first)
    train()
    assert settings.output_path == settings.derived_output == "//a_2.frog"
    settings.capture_folder = str(second)
    assert settings.output_path.endswith("b.frog")
