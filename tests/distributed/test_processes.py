"""Two gloo processes train one scene: the same one as a single process, and one of them may be lost."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support import shared_training

from frog_blender.engine.distributed.environment import number, started_by_torchrun
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training

pytestmark = pytest.mark.integration


def started(capture: Path, output: Path, steps: int, size: int = 2) -> list[subprocess.Popen[str]]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    together = {"WORLD_SIZE": str(size), "LOCAL_WORLD_SIZE": str(size)}
    place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, shared_training.__file__, str(capture), str(output), str(steps)]
    return [
        subprocess.Popen(
            command,
            env={**os.environ, **together, **place, "RANK": str(rank), "LOCAL_RANK": str(rank)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(size)
    ]


def arrays(output: Path) -> dict[str, np.ndarray]:
    return read_tensors(checkpoint_path(output), "a training checkpoint")[0]


def test_two_processes_train_what_one_does_with_two_views_a_step(filmed: Path, tmp_path: Path) -> None:
    """Density control, anchors, pruning, poses and compression in between; every number that is kept."""
    processes = started(filmed, tmp_path / "two.frog", 200)
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    assert "Finished" in ends[0][0] and not ends[1][0]
    last = list(run_training(shared_training.job(filmed, tmp_path / "one.frog", 200, views=2)))[-1]
    assert isinstance(last, events.Finished)
    two, one = arrays(tmp_path / "two.frog"), arrays(tmp_path / "one.frog")
    assert two.keys() == one.keys() and len(one["model.canonical.means"]) > 300
    for name, expected in one.items():
        assert np.array_equal(two[name], expected), name


@pytest.mark.parametrize("killed", [0, 1])
def test_a_killed_process_ends_the_training_and_one_process_goes_on(filmed: Path, tmp_path: Path, killed: int) -> None:
    output = tmp_path / "scene.frog"
    processes = started(filmed, output, 100_000)
    stdout = processes[0].stdout
    assert stdout is not None
    while stdout.readline().strip() != "Progress":
        assert processes[0].poll() is None, processes[0].communicate()
    time.sleep(0.5)
    processes[killed].send_signal(signal.SIGKILL)
    other = processes[1 - killed]
    try:
        _, said = other.communicate(timeout=30)
    finally:
        for process in processes:
            process.kill()
    assert other.returncode == 1
    sentence = said.strip().splitlines()[-1]
    assert "--resume" in sentence and str(checkpoint_path(output)) in sentence
    reached = int(read_step(output))
    assert reached > 0
    job = shared_training.job(filmed, output, reached + 10, resume=True)
    job = type(job)(**{**vars(job), "steps": reached + 10})
    *_, last = run_training(job)
    assert isinstance(last, events.Finished) and last.steps == reached + 10


def read_step(output: Path) -> int:
    import json

    values = json.loads(read_tensors(checkpoint_path(output), "a training checkpoint")[1]["frog-checkpoint"])
    assert values["recipe"]["views_per_step"] == 2
    return int(values["step_count"])


def test_the_environment_tells_of_other_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RANK", raising=False)
    assert not started_by_torchrun()
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "1")
    assert not started_by_torchrun()
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert started_by_torchrun()
    monkeypatch.setenv("WORLD_SIZE", "two")
    with pytest.raises(FrogError, match="WORLD_SIZE is 'two', expected a whole number"):
        number("WORLD_SIZE", 1)
