"""A training that goes on does so with the capture and the settings that it began with."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from frog_blender.engine.errors import FrogError
from frog_blender.engine.files import read_scene
from frog_blender.engine.training import events
from frog_blender.engine.training.checkpoint import checkpoint_path
from frog_blender.engine.training.job import TrainingJob, run_training

pytestmark = pytest.mark.usefixtures("seeds_at_no_cost")


@pytest.fixture
def task(filmed: Path, tmp_path: Path, lively: Callable) -> TrainingJob:
    """Six steps are done, and it goes on to nine."""
    shutil.copytree(filmed, tmp_path / "capture")
    began = TrainingJob(tmp_path / "capture", tmp_path / "x.frog", recipe=lively(6), seed=2, device="cpu")
    list(run_training(began))
    return replace(began, resume=True, steps=9)


def said(task: TrainingJob) -> list[str]:
    """Warnings of a training that finishes."""
    stream = list(run_training(task))
    assert isinstance(stream[-1], events.Finished)
    return [event.message for event in stream if isinstance(event, events.Warned)]


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


def test_only_what_somebody_chose_is_said_to_be_left_aside(task: TrainingJob) -> None:
    other = replace(task, seed=3, holdout_frames=3, scale=0.5, lossless=True)
    assert not said(other)
    told = "The training goes on as it began: method frog, recipe draft, capacity fixed; left aside: seed, exact."
    assert said(replace(other, chosen={"seed": "seed", "lossless": "exact", "method": "method"}, steps=12)) == [told]
