"""Processes that train one scene: what they agree on, the same bits as a single one, and one of them may be lost."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support import shared_training

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.view_pass import ALONE, PeerLost, agreed, shared
from frog_blender.engine.training.session import events, loop, processes
from frog_blender.engine.training.session.output_paths import checkpoint_path, header_of
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
        address = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free.getsockname()[1]}
    together = {**address, "WORLD_SIZE": 2, "LOCAL_WORLD_SIZE": 2}
    command = (shared_training.__file__, capture, output, steps)
    return [start(*command, **together, RANK=rank, LOCAL_RANK=rank) for rank in range(2)]


def wait_for(process: subprocess.Popen[str], steps: int) -> None:
    """Each of which it tells of."""
    assert process.stdout is not None
    while steps:
        event = process.stdout.readline().strip()
        assert event, process.communicate()
        steps -= event == "Progress"


def arrays_of(output: Path) -> dict[str, np.ndarray]:
    return read_tensors(checkpoint_path(output), "a training checkpoint")[0]


def values_of(output: Path) -> dict[str, Any]:
    return header_of(checkpoint_path(output))


def test_two_processes_train_what_one_does_with_two_views_a_step(start: Start, filmed: Path, tmp_path: Path) -> None:
    """To the bit, after density control, new anchors, pruning, moved cameras and compression."""
    processes = start_two(start, filmed, tmp_path / "two.frog", 80)
    *before, last = run_training(shared_training.job(filmed, tmp_path / "one.frog", 80, views=2))
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    assert "Finished" in ends[0][0] and not ends[1][0]
    assert isinstance(last, events.Finished) and any(isinstance(event, events.Reduced) for event in before)
    two, one = arrays_of(tmp_path / "two.frog"), arrays_of(tmp_path / "one.frog")
    began = next(event for event in before if isinstance(event, events.Started))
    assert values_of(tmp_path / "one.frog")["step_count"] == 80 and len(one["model.canonical.means"]) != began.gaussians
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
    reached = values_of(output)["step_count"]
    assert reached >= 40
    *_, last = run_training(shared_training.job(filmed, output, reached + 10, resume=True))
    assert isinstance(last, events.Finished) and last.steps == reached + 10
    assert values_of(output)["recipe"]["views_per_step"] == 2


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
        steps = values_of(output)["step_count"]
        again = start(*torchrun_of, *command, "--resume", "--steps", steps + more)
        assert again.communicate(timeout=300)[0] and again.returncode == 0
        assert values_of(output)["step_count"] == steps + more


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


class Store:
    """In which one heart beats."""

    def __init__(self, is_lost: bool) -> None:
        self.is_lost, self.beats = is_lost, 0

    def set(self, _key: str, _value: str) -> None:
        self.beats += 1
        if self.is_lost:
            raise RuntimeError("Connection reset by peer")


@pytest.mark.parametrize(("is_lost", "parents"), [(True, (7, 7)), (False, (7, 1))], ids=["its store", "its process"])
def test_a_lost_launcher_ends_the_training(
    is_lost: bool, parents: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "_BEAT", 0.01)
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "1")
    told = iter(parents)
    monkeypatch.setattr(os, "getppid", lambda: next(told, parents[1]))
    store: Any = Store(is_lost)
    peers = processes.Processes(store, 0, 1, decodes_first=True)
    while store.beats < 2:
        time.sleep(0.01)
    with pytest.raises(PeerLost, match="What has started the processes"):
        peers.add(torch.zeros(1))
    assert peers.is_broken
    peers.leave()


class Thread:
    """See Peers; the tensors lie in a list that all threads see."""

    def __init__(self, rank: int, tensors: list[torch.Tensor], barrier: threading.Barrier) -> None:
        self.rank, self.size, self.decodes_first = rank, len(tensors), rank == 0
        self._tensors, self._barrier = tensors, barrier

    def add(self, tensor: torch.Tensor) -> None:
        self._reduce(tensor, lambda tensors: tensors.sum(0))

    def maximum(self, tensor: torch.Tensor) -> None:
        self._reduce(tensor, lambda tensors: tensors.amax(0))

    def _reduce(self, tensor: torch.Tensor, operation: Callable[[torch.Tensor], torch.Tensor]) -> None:
        self._tensors[self.rank] = tensor.clone()
        self._barrier.wait(60)
        tensor.copy_(operation(torch.stack(self._tensors)))
        self._barrier.wait(60)


def together(work: Callable[[Thread], Any], size: int = 2) -> list[Any]:
    """What ``work`` returns for each of the peers, all of which do it at the same time."""
    barrier, tensors = threading.Barrier(size), [torch.zeros(0)] * size

    def do(rank: int) -> Any:
        try:
            return work(Thread(rank, tensors, barrier))
        except BaseException:
            barrier.abort()  # the others do not wait for it
            raise

    with ThreadPoolExecutor(size) as threads:
        return list(threads.map(do, range(size)))


def test_any_wish_counts_and_facts_are_compared() -> None:
    assert together(lambda peer: agreed(peer, (peer.rank == 1, False), (7, -3))) == [((True, False), True)] * 2
    assert together(lambda peer: agreed(peer, (False,), (2**54 + peer.rank,))) == [((False,), False)] * 2
    assert agreed(ALONE, (True,), (1,)) == ((True,), True)


def test_all_have_what_the_first_one_has() -> None:
    assert together(lambda peer: shared(peer, b"its state" if peer.rank == 0 else None), 3) == [b"its state"] * 3
    assert shared(ALONE, b"") == b""


def test_a_peer_that_has_learned_something_else_takes_over_what_the_first_has(
    filmed: Path, own_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processors may round differently."""
    trainers: dict[int, Trainer] = {}
    monkeypatch.setattr(loop, "_COMPARED_EVERY", 30)

    def train(peer: Any) -> events.Event | None:
        def make(*arguments: Any, **named: Any) -> Trainer:
            trainers[peer.rank] = trainer = Trainer(*arguments, **named)
            return trainer

        job = shared_training.job(filmed, tmp_path / "x.frog", 50)
        last: events.Event | None = None
        for event in run_training(job, trainer_type=make, peers=peer):
            last = event
            if peer.rank == 1 and trainers[1].step_count == 17:
                trainers[1].model.canonical.means.data += 1e-3
        return last

    first, _ = together(train)
    assert isinstance(first, events.Finished)
    others = trainers[1].state()[0]
    for name, expected in trainers[0].state()[0].items():
        assert torch.equal(others[name], expected), name
