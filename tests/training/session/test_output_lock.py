"""One training at a time writes a scene: across processes, and never blocked by one that is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.builders import REPOSITORY

from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import lock_output
from frog_blender.engine.training.session.run import run_training

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
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(output)],
        cwd=REPOSITORY,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline() == "claimed\n"
        yield process
    finally:
        process.communicate()


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    (tmp_path / "out").mkdir()
    return tmp_path / "out" / "x.frog"


def test_a_second_process_is_refused_until_the_first_ends(output: Path) -> None:
    with another_training(output) as process:
        with (
            pytest.raises(
                FrogError, match=rf"x\.frog: another training \(process {process.pid}\) writes this file"
            ) as caught,
            lock_output(output),
        ):
            pass
        assert "\n" not in str(caught.value)
        with lock_output(output.with_name("y.frog")):
            pass
    with lock_output(output):
        pass
    assert not list(output.parent.iterdir()) and not list((output.parents[1] / "cache").iterdir())


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a process that is killed")
def test_a_killed_process_blocks_nobody(output: Path) -> None:
    with another_training(output) as process:
        process.kill()
        process.wait()
        with lock_output(output), pytest.raises(FrogError), lock_output(output):
            pass
    assert not list((output.parents[1] / "cache").iterdir())


def test_one_place_under_two_names_is_one(output: Path) -> None:
    (output.parents[1] / "link").symlink_to(output.parent)
    with lock_output(output):
        for other in (output.parents[1] / "link" / "x.frog", output.parent / ".." / "out" / "x.frog"):
            with pytest.raises(FrogError), lock_output(other):
                pass
        here = os.getcwd()
        os.chdir(output.parent)
        try:
            with pytest.raises(FrogError), lock_output(Path("x.frog")):
                pass
        finally:
            os.chdir(here)


def test_where_no_locks_are_kept_one_trains_all_the_same(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (output.parent / "file").write_text("")
    monkeypatch.setenv("FROG_CACHE", str(output.parent / "file"))
    with lock_output(output):
        pass


def test_a_training_into_a_path_that_is_claimed_is_refused_before_anything(output: Path, filmed: Path) -> None:
    unfinished = output.with_name(".x.frog.0123.part")
    unfinished.write_bytes(b"the other's")
    with another_training(output), pytest.raises(FrogError, match="another training"):
        next(run_training(TrainingJob(filmed, output, device="cpu")))
    assert unfinished.exists()


def test_an_output_is_free_again_when_nobody_listens_any_more(output: Path, filmed: Path, quick_seeds: None) -> None:
    stream = run_training(TrainingJob(filmed, output, device="cpu"))
    next(stream)
    with pytest.raises(FrogError), lock_output(output):
        pass
    stream.close()
    with lock_output(output):
        pass
