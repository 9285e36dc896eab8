"""A training that goes on does so with the capture and the settings that it began with."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import synthetic_capture as film

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.session import checkpoint, events
from frog_blender.engine.training.session.checkpoint import restore_job, write_checkpoint
from frog_blender.engine.training.session.job import STORED, TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path, is_of_another
from frog_blender.engine.training.session.run import run_training


@pytest.fixture
def task(filmed: Path, tmp_path: Path, lively: Callable, own_cache: Path) -> TrainingJob:
    """Six steps are done, and it goes on to nine."""
    shutil.copytree(filmed, tmp_path / "capture")
    began = TrainingJob(
        tmp_path / "capture", tmp_path / "x.frog", recipe=lively(6), seed=2, seeds=film.seeds(), device="cpu"
    )
    list(run_training(began))
    return replace(began, resume=True, steps=9)


def said(task: TrainingJob) -> list[str]:
    """Warnings of a training that finishes."""
    stream = list(run_training(task))
    assert isinstance(stream[-1], events.Finished)
    return [event.message for event in stream if isinstance(event, events.WarningEvent)]


def test_another_capture_that_is_still_there_is_refused(task: TrainingJob, tmp_path: Path) -> None:
    shutil.copytree(task.capture, tmp_path / "other")
    with pytest.raises(FrogError, match=r"a training of another capture, .*capture, expected .*other\.$") as caught:
        list(run_training(replace(task, capture=tmp_path / "other")))
    assert str(caught.value).startswith(str(checkpoint_path(task.output)))
    assert read_scene(task.output).header.steps == 6


def test_the_same_capture_by_another_way_goes_on(
    task: TrainingJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "link").symlink_to(task.capture)
    assert not said(replace(task, capture=tmp_path / "link"))
    monkeypatch.chdir(tmp_path)
    assert not said(replace(task, capture=Path("capture"), steps=12))


@pytest.mark.parametrize("left", [False, True])
def test_a_capture_that_moved_goes_on(task: TrainingJob, tmp_path: Path, left: bool) -> None:
    task.capture.rename(tmp_path / "moved")
    if left:  # a folder that is no capture any more
        task.capture.mkdir()
    assert not said(replace(task, capture=tmp_path / "moved"))


def test_only_settings_that_the_user_chose_are_said_to_be_ignored(task: TrainingJob) -> None:
    other = replace(task, seed=3, holdout_frames=3, scale=0.5, lossless=True)
    assert not said(other)
    told = "Resuming with the original settings: method frog, recipe draft, capacity fixed; ignored: seed, exact."
    assert said(replace(other, chosen={"seed": "seed", "lossless": "exact", "method": "method"}, steps=12)) == [told]


def rewritten(task: TrainingJob, **settings: Any) -> TrainingJob:
    """The task, whose checkpoint says something else of how it began."""
    path = checkpoint_path(task.output)
    arrays, metadata = read_tensors(path, "a training checkpoint")
    values = json.loads(metadata["frog-checkpoint"])
    values["settings"] |= settings
    write_checkpoint(path, (arrays, values))
    return task


def test_what_a_checkpoint_says_of_its_job_is_looked_at(task: TrainingJob) -> None:
    restore_job(task)
    before = json.loads(read_tensors(checkpoint_path(task.output), "")[1]["frog-checkpoint"])["settings"]
    hostile = [*((name, "x\ny") for name in STORED), ("seed", 2**40), ("scale", math.nan), ("steps", True)]
    for name, value in [*hostile, ("pixel_offsets", {"a": [1, math.nan]})]:
        with pytest.raises(FrogError, match=rf"settings that do not fit \({name} is ") as caught:
            restore_job(rewritten(task, **{name: value}))
        assert "\n" not in str(caught.value)
        rewritten(task, **{name: before[name]})
    restore_job(task)


def test_a_recipe_that_none_can_be_never_begins(task: TrainingJob) -> None:
    """A negative number of seed points was looked for without an end."""
    path = checkpoint_path(task.output)
    recipe = json.loads(read_tensors(path, "")[1]["frog-checkpoint"])["settings"]["recipe"]
    for name, value in (("seed_gaussians", -1), ("seed_gaussians", 0), ("head_width", 10**9), ("speed", 1)):
        with pytest.raises(FrogError, match=name):
            list(run_training(rewritten(task, recipe=recipe | {name: value})))


def test_no_computer_is_called_that_a_checkpoint_names(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at: list[str] = []
    monkeypatch.setattr(checkpoint, "detect", lambda path: looked_at.append(str(path)))
    task.output.unlink()
    for share in (r"\\evil\share\other", "/\\evil/share/other", "//evil/share/other"):
        rewritten(task, capture=share)
        with monkeypatch.context() as watched:
            watched.setattr("os.path.exists", lambda path: looked_at.append(str(path)) or False)
            assert is_of_another(task.output.with_name("none.frog"), task.capture) is False
            assert is_of_another(task.output, Path("/somewhere/other"))
        restore_job(task)
    assert not [path for path in looked_at if "evil" in path]
