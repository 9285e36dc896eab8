"""Which file a training may write: its own capture's, never another's, and one training at a time."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file
from support.builders import REPOSITORY, refused
from support.training_steps import MakeJob

from frog_blender.cli.main import main
from frog_blender.engine.io.atomic_files import LONGEST_NAME, write_atomically
from frog_blender.engine.training.session import events, output_paths
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


def checkpoint(output: Path, capture: Path, **told: float) -> None:
    state = json.dumps({"settings": {"capture": str(capture)}, **told})
    save_file({"x": np.zeros(1)}, output_paths.checkpoint_path(output), metadata={"frog-checkpoint": state})


@pytest.fixture
def captures(tmp_path: Path) -> tuple[Path, Path]:
    for name in "ab":
        (tmp_path / name).mkdir()
    return tmp_path / "a", tmp_path / "b"


def test_what_a_training_leaves_names_its_capture(filmed: Path, tmp_path: Path, make_job: MakeJob) -> None:
    list(run_training(job := make_job(4)))
    output = job.output
    for path in (output, output_paths.checkpoint_path(output)):
        assert output_paths.trained_from(path) == str(filmed.resolve())
    assert not output_paths.is_of_another(output, filmed) and output_paths.free_output(output, filmed) == output
    (tmp_path / "other").mkdir()
    assert output_paths.free_output(output, tmp_path / "other") == tmp_path / "x_2.frog"


def test_a_killed_trainings_checkpoint_is_its_captures_too(captures: tuple[Path, Path], tmp_path: Path) -> None:
    first, second = captures
    for name in ("x.frog", "x_2.frog"):
        checkpoint(tmp_path / name, first)
    assert output_paths.free_output(tmp_path / "x.frog", first) == tmp_path / "x.frog"
    assert output_paths.free_output(tmp_path / "x.frog", second) == tmp_path / "x_3.frog"
    checkpoint(tmp_path / "x.frog", second)  # it changed: what was read before no longer counts
    assert output_paths.free_output(tmp_path / "x.frog", second) == tmp_path / "x.frog"


def test_a_capture_goes_on_where_it_was_cut_short(captures: tuple[Path, Path], tmp_path: Path) -> None:
    first, second = captures
    output, later, others = (tmp_path / name for name in ("x.frog", "x_2.frog", "x_3.frog"))
    checkpoint(output, first, progress=1.0, step_count=9)
    checkpoint(later, first, progress=0.5, step_count=4)
    checkpoint(others, second, progress=0.5, step_count=4)
    assert output_paths.free_output(output, first) == later, "the finished one before it cannot be resumed"
    checkpoint(later, first, progress=1.0, step_count=9)
    assert output_paths.free_output(output, first) == output


def test_a_capture_that_moved_is_the_same(captures: tuple[Path, Path], tmp_path: Path) -> None:
    first, _ = captures
    checkpoint(tmp_path / "x.frog", first)
    moved = tmp_path / "elsewhere" / "a"
    shutil.copytree(first, moved)
    assert output_paths.is_of_another(tmp_path / "x.frog", moved), "two of one name, as long as both are there"
    shutil.rmtree(first)
    assert not output_paths.is_of_another(tmp_path / "x.frog", moved)
    assert output_paths.is_of_another(tmp_path / "x.frog", tmp_path / "b")


@pytest.mark.parametrize("metadata", [None, {"frog": "[1"}, {"frog": "[]"}, {"frog-checkpoint": '{"settings": {}}'}])
def test_what_says_nothing_is_nobodys(tmp_path: Path, metadata: dict | None) -> None:
    output = tmp_path / "x.frog"
    assert output_paths.trained_from(output) == ""
    if metadata is None:
        output.write_bytes(b"no scene")
    else:
        save_file({"x": np.zeros(1)}, output, metadata=metadata)
    assert output_paths.trained_from(output) == "" and not output_paths.is_of_another(output, tmp_path)


def test_a_new_training_gets_a_name_that_nothing_has(tmp_path: Path) -> None:
    output = tmp_path / "x.frog"
    assert output_paths.unused_output(output) == output
    output.write_bytes(b"a scene")
    output_paths.checkpoint_path(tmp_path / "x_2.frog").write_bytes(b"a training that did not end")
    assert output_paths.unused_output(output) == tmp_path / "x_3.frog"
    output_paths.check_unused(tmp_path / "x_3.frog")
    for taken, word in ((output, r"x\.frog: found a file"), (tmp_path / "x_2.frog", r"x_2\.frog\.checkpoint: found")):
        refused(word, output_paths.check_unused, taken)


def test_a_taken_name_is_refused_in_the_words_of_where_it_was_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A panel has no options of a command line."""
    output = tmp_path / "x.frog"
    output.write_bytes(b"a scene")
    job = TrainingJob(tmp_path, output, overwrite=False, device="cpu")
    refused(r"there already; another name keeps it\.$", next, run_training(job))
    assert main(["train", str(tmp_path), "--out", str(output)]) == 2
    assert "--overwrite replaces it, --resume goes on" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["動" * 80, "x" * 250], ids=["kanji", "latin"])
def test_any_legal_name_gets_scene_and_checkpoint(tmp_path: Path, make_job: MakeJob, name: str) -> None:
    folder = tmp_path / "out"
    job = make_job(4, {"output": folder / f"{name}.frog"}, capacity="auto")
    *_, end = run_training(job)
    assert isinstance(end, events.Finished) and end.path == str(job.output) and job.output.is_file()
    assert output_paths.checkpoint_path(job.output).is_file() and len(os.listdir(folder)) == 2
    assert all(len(os.fsencode(entry)) <= LONGEST_NAME for entry in os.listdir(folder))


def test_a_name_that_no_disk_takes_is_refused_before_training(filmed: Path, tmp_path: Path) -> None:
    job = TrainingJob(filmed, tmp_path / f"{'x' * 300}.frog", device="cpu")
    refused("no file can have this name", next, run_training(job))
    assert not list(tmp_path.iterdir())


def test_checkpoints_of_long_names_are_told_apart(tmp_path: Path) -> None:
    assert output_paths.checkpoint_path(tmp_path / "x.frog") == tmp_path / "x.frog.checkpoint"
    long = [output_paths.checkpoint_path(tmp_path / f"{'x' * 244}{end}.frog") for end in "ab"]
    assert len(set(long)) == 2
    for path in long:
        write_atomically(path, b"")


HOLD = """
import sys
from pathlib import Path
from frog_blender.engine.training.session.output_paths import lock_output
with lock_output(Path(sys.argv[1])):
    print("claimed", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_training(output: Path) -> Iterator[subprocess.Popen]:
    """A process to which ``output`` belongs until the block, or the process, ends."""
    command, pipes = [sys.executable, "-c", HOLD, str(output)], {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=REPOSITORY, text=True, **pipes) as process:
        assert process.stdout is not None and process.stdout.readline() == "claimed\n"
        yield process


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    (tmp_path / "out").mkdir()
    return tmp_path / "out" / "x.frog"


def claim(output: Path) -> None:
    with output_paths.lock_output(output):
        pass


def test_a_second_process_is_refused_until_the_first_ends(output: Path) -> None:
    with another_training(output) as process:
        refused(rf"x\.frog: another training \(process {process.pid}\) writes this file", claim, output)
        claim(output.with_name("y.frog"))
    claim(output)
    assert not list(output.parent.iterdir()) and not list((output.parents[1] / "cache").iterdir())


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a process that is killed")
def test_a_killed_process_blocks_nobody(output: Path) -> None:
    with another_training(output) as process:
        process.kill()
        process.wait()
        with output_paths.lock_output(output):
            refused("another training", claim, output)
    assert not list((output.parents[1] / "cache").iterdir())


def test_one_place_under_two_names_is_one(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (output.parents[1] / "link").symlink_to(output.parent)
    with output_paths.lock_output(output):
        for other in (output.parents[1] / "link" / "x.frog", output.parent / ".." / "out" / "x.frog"):
            refused("another training", claim, other)
        monkeypatch.chdir(output.parent)
        refused("another training", claim, Path("x.frog"))


def test_where_no_locks_are_kept_one_trains_all_the_same(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (output.parent / "file").write_text("")
    monkeypatch.setenv("FROG_CACHE", str(output.parent / "file"))
    claim(output)


def test_a_training_into_a_path_that_is_claimed_is_refused_before_anything(output: Path, filmed: Path) -> None:
    unfinished = output.with_name(".x.frog.0123.part")
    unfinished.write_bytes(b"the other's")
    with another_training(output):
        refused("another training", next, run_training(TrainingJob(filmed, output, device="cpu")))
    assert unfinished.exists()


def test_an_output_is_free_again_when_nobody_listens_any_more(output: Path, filmed: Path, quick_seeds: None) -> None:
    stream = run_training(TrainingJob(filmed, output, device="cpu"))
    next(stream)
    refused("another training", claim, output)
    stream.close()
    claim(output)
