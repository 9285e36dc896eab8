"""Two gloo processes train one scene: the same one as a single process, and one of them may be lost."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from support import shared_training

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.torchrun import number, started_by_torchrun

Start = Callable[..., subprocess.Popen[str]]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")


@pytest.fixture
def start(own_cache: Path) -> Iterator[Start]:
    """``start(*arguments, **environment)``: a Python process of one torch thread, which ends with the test."""
    started: list[subprocess.Popen[str]] = []

    def begin(*arguments: object, **environment: object) -> subprocess.Popen[str]:
        own = {**os.environ, "OMP_NUM_THREADS": "1", **{name: str(value) for name, value in environment.items()}}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(subprocess.Popen([sys.executable, *map(str, arguments)], env=own, text=True, **pipes))
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def start_two(start: Start, capture: Path, output: Path, steps: int) -> list[subprocess.Popen[str]]:
    """By rank."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free.getsockname()[1]}
    together = {**place, "WORLD_SIZE": 2, "LOCAL_WORLD_SIZE": 2}
    command = (shared_training.__file__, capture, output, steps)
    return [start(*command, **together, RANK=rank, LOCAL_RANK=rank) for rank in range(2)]


def wait_for(process: subprocess.Popen[str], steps: int) -> None:
    """Each of which it tells of."""
    assert process.stdout is not None
    while steps:
        event = process.stdout.readline().strip()
        assert event, process.communicate()
        steps -= event == "Progress"


def checkpoint(output: Path) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    arrays, metadata = read_tensors(checkpoint_path(output), "a training checkpoint")
    return arrays, json.loads(metadata["frog-checkpoint"])


def test_two_processes_train_what_one_does_with_two_views_a_step(start: Start, filmed: Path, tmp_path: Path) -> None:
    """To the bit, after density control, new anchors, pruning, moved cameras and compression."""
    processes = start_two(start, filmed, tmp_path / "two.frog", 80)
    *before, last = run_training(shared_training.job(filmed, tmp_path / "one.frog", 80, views=2))
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    assert "Finished" in ends[0][0] and not ends[1][0]
    assert isinstance(last, events.Finished) and any(isinstance(event, events.Reduced) for event in before)
    (two, _), (one, values) = checkpoint(tmp_path / "two.frog"), checkpoint(tmp_path / "one.frog")
    began = next(event for event in before if isinstance(event, events.Started))
    assert values["step_count"] == 80 and len(one["model.canonical.means"]) != began.gaussians
    assert two.keys() == one.keys()
    for name, expected in one.items():
        assert np.array_equal(two[name], expected), name


@pytest.mark.parametrize(
    ("lost", "how"),
    [
        (1, "SIGKILL"),
        pytest.param(0, "SIGKILL", marks=pytest.mark.slow),
        pytest.param(1, "SIGSTOP", marks=pytest.mark.slow),
    ],
    ids=["another", "the first", "one that hangs"],
)
def test_a_lost_process_ends_the_training_and_one_process_goes_on(
    start: Start, filmed: Path, tmp_path: Path, lost: int, how: str
) -> None:
    output = tmp_path / "scene.frog"
    processes = start_two(start, filmed, output, 1000)
    wait_for(processes[0], 40)
    processes[lost].send_signal(getattr(signal, how))
    _, said = processes[1 - lost].communicate(timeout=300)
    assert processes[1 - lost].returncode == 1
    sentence = said.strip().splitlines()[-1]
    assert "--resume" in sentence and str(checkpoint_path(output)) in sentence
    reached = checkpoint(output)[1]["step_count"]
    assert isinstance(reached, int) and reached >= 40
    *_, last = run_training(shared_training.job(filmed, output, reached + 10, resume=True))
    assert isinstance(last, events.Finished) and last.steps == reached + 10
    recipe = checkpoint(output)[1]["recipe"]
    assert isinstance(recipe, dict) and recipe["views_per_step"] == 2


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks for torchrun's processes in /proc")
def test_torchrun_starts_the_command_and_it_resumes_with_any_number(start: Start, filmed: Path, tmp_path: Path) -> None:
    """Started, killed, resumed by one process, and then by two."""
    output = tmp_path / "scene.frog"
    command = ("-m", "frog_blender.cli", "train", filmed, "--out", output, "--recipe", "draft", "--device", "cpu")
    torchrun = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node")
    two = start(*torchrun, 2, *command, "--save-every", 1)
    while not checkpoint_path(output).exists():
        assert two.poll() is None, two.communicate()
    children = Path(f"/proc/{two.pid}/task/{two.pid}/children").read_text().split()
    os.kill(int(children[-1]), signal.SIGKILL)
    _, said = two.communicate(timeout=300)
    assert two.returncode != 0 and "--resume goes on with any number of processes" in said
    for torchrun_of, more in ((), 10), ((*torchrun, 2), 20):
        steps = checkpoint(output)[1]["step_count"]
        assert isinstance(steps, int)
        again = start(*torchrun_of, *command, "--resume", "--steps", steps + more)
        assert again.communicate(timeout=300)[0] and again.returncode == 0
        assert checkpoint(output)[1]["step_count"] == steps + more


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
