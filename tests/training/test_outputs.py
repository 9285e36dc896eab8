"""Which file a training may write: its own capture's, never another's."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from frog_blender.engine.training.checkpoint import checkpoint_path
from frog_blender.engine.training.job import TrainingJob, run_training
from frog_blender.engine.training.outputs import free_output, is_of_another, trained_from


def checkpoint(output: Path, capture: Path) -> None:
    state = json.dumps({"settings": {"capture": str(capture)}})
    save_file({"x": np.zeros(1)}, checkpoint_path(output), metadata={"frog-checkpoint": state})


@pytest.fixture
def captures(tmp_path: Path) -> tuple[Path, Path]:
    for name in "ab":
        (tmp_path / name).mkdir()
    return tmp_path / "a", tmp_path / "b"


def test_what_a_training_leaves_names_its_capture(
    filmed: Path, tmp_path: Path, lively: Callable, seeds_at_no_cost: None
) -> None:
    output = tmp_path / "x.frog"
    list(run_training(TrainingJob(filmed, output, recipe=lively(4), seed=2, device="cpu")))
    for path in (output, checkpoint_path(output)):
        assert trained_from(path) == str(filmed.resolve())
    assert not is_of_another(output, filmed) and free_output(output, filmed) == output
    (tmp_path / "other").mkdir()
    assert free_output(output, tmp_path / "other") == tmp_path / "x_2.frog"


def test_a_killed_trainings_checkpoint_is_its_captures_too(captures: tuple[Path, Path], tmp_path: Path) -> None:
    first, second = captures
    for name in ("x.frog", "x_2.frog"):
        checkpoint(tmp_path / name, first)
    assert free_output(tmp_path / "x.frog", first) == tmp_path / "x.frog"
    assert free_output(tmp_path / "x.frog", second) == tmp_path / "x_3.frog"
    checkpoint(tmp_path / "x.frog", second)  # it changed: what was read before no longer counts
    assert free_output(tmp_path / "x.frog", second) == tmp_path / "x.frog"


def test_a_capture_that_moved_is_the_same(captures: tuple[Path, Path], tmp_path: Path) -> None:
    first, _ = captures
    checkpoint(tmp_path / "x.frog", first)
    moved = tmp_path / "elsewhere" / "a"
    shutil.copytree(first, moved)
    assert is_of_another(tmp_path / "x.frog", moved), "two of one name, as long as both are there"
    shutil.rmtree(first)
    assert not is_of_another(tmp_path / "x.frog", moved)
    assert is_of_another(tmp_path / "x.frog", tmp_path / "b")


@pytest.mark.parametrize("metadata", [None, {"frog": "[1"}, {"frog": "[]"}, {"frog-checkpoint": '{"settings": {}}'}])
def test_what_says_nothing_is_nobodys(tmp_path: Path, metadata: dict | None) -> None:
    output = tmp_path / "x.frog"
    assert trained_from(output) == ""
    if metadata is None:
        output.write_bytes(b"no scene")
    else:
        save_file({"x": np.zeros(1)}, output, metadata=metadata)
    assert trained_from(output) == "" and not is_of_another(output, tmp_path)
