"""Two processes on this machine learn what one does, and one that is left alone keeps what was learned."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file
from support.shared_training import VIEWS, job_of

from frog_blender.engine.training.optimize.peers import Alone
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training

STEPS = 200
Start = Callable[[Path, int], list["subprocess.Popen[str]"]]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="torch's wheels for Windows find each other otherwise")


@pytest.fixture
def start(filmed: Path, own_cache: Path) -> Iterator[Start]:
    """``start(output, steps)``: the processes of one training, by rank."""
    script = Path(__file__).parents[1] / "support" / "shared_training.py"
    started: list[subprocess.Popen[str]] = []

    def begin(output: Path, steps: int) -> list[subprocess.Popen[str]]:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        of_all = {"WORLD_SIZE": str(VIEWS), "LOCAL_WORLD_SIZE": str(VIEWS), "OMP_NUM_THREADS": "1"}
        of_all |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
        for rank in range(VIEWS):
            own = {**os.environ, **of_all, "RANK": str(rank), "LOCAL_RANK": str(rank)}
            command = [sys.executable, str(script), str(filmed), str(output), str(steps)]
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            started.append(subprocess.Popen(command, env=own, text=True, **pipes))
        return started

    yield begin
    for process in started:
        process.kill()
        process.wait()
        for pipe in (process.stdout, process.stderr):
            assert pipe is not None
            pipe.close()


def ended(process: subprocess.Popen[str], seconds: float) -> str:
    """Standard error of a process that ends within so many seconds."""
    return process.communicate(timeout=seconds)[1]


def differences(one: Path, other: Path) -> dict[str, float]:
    """The largest difference of each array of two files, relative to its largest number."""
    arrays, others = load_file(one), load_file(other)
    assert arrays.keys() == others.keys()
    found = {}
    for name, array in arrays.items():
        assert array.shape == others[name].shape, name
        unknown = ~np.isfinite(array.astype(float))
        assert (unknown == ~np.isfinite(others[name].astype(float))).all()
        known = np.where(unknown, 0, array).astype(float)
        change = np.abs(np.where(unknown, 0, others[name]).astype(float) - known)
        found[name] = float(change.max(initial=0) / max(np.abs(known).max(initial=0), 1e-30))
    return found


def test_two_processes_learn_what_one_does_with_the_same_views(start: Start, filmed: Path, tmp_path: Path) -> None:
    processes = start(tmp_path / "two.frog", STEPS)
    alone = list(run_training(job_of(filmed, tmp_path / "one.frog", STEPS)))
    assert [ended(process, 300) for process in processes] == ["", ""]
    assert [process.returncode for process in processes] == [0, 0]
    assert isinstance(alone[-1], events.Finished)
    assert any(isinstance(event, events.Reduced) for event in alone)
    began = next(event for event in alone if isinstance(event, events.Started))
    assert any(event.gaussians > began.gaussians for event in alone if isinstance(event, events.Progress))
    for ending in (".frog", ".frog.checkpoint"):
        found = differences(tmp_path / f"one{ending}", tmp_path / f"two{ending}")
        assert max(found.values()) <= 1e-5, found


@pytest.mark.parametrize("lost", [0, 1])
def test_a_process_that_is_left_alone_ends_with_a_checkpoint(
    start: Start, filmed: Path, tmp_path: Path, lost: int
) -> None:
    output = tmp_path / "x.frog"
    processes = start(output, 100_000)
    told = processes[0].stdout
    assert told is not None
    while told.readline() != "step 20\n":
        assert processes[0].poll() is None
    processes[lost].kill()
    sentence = ended(processes[1 - lost], 30)
    assert processes[1 - lost].returncode == 1
    assert len(sentence.splitlines()) == 1 and "of this training has ended" in sentence
    assert str(checkpoint_path(output)) in sentence and "--resume goes on" in sentence
    job = replace(job_of(filmed, output, 100_000), resume=True)
    stopped: list[int] = []
    for event in run_training(job, lambda: len(stopped) > 3):
        if isinstance(event, events.Progress):
            stopped.append(event.step)
    assert stopped[0] >= 20 and stopped[-1] > stopped[0]


def test_a_training_alone_hears_itself() -> None:
    alone = Alone()
    assert alone.gather([1, 2]) == [[1, 2]] and alone.first_of(0.5) == 0.5 and alone.from_first(b"x") == b"x"
