"""What processes that train together agree on, with threads of this one in their place."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from support import shared_training

from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.view_pass import ALONE, agreed, shared
from frog_blender.engine.training.session import events, loop
from frog_blender.engine.training.session.run import run_training


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
    barrier, tensors, found = threading.Barrier(size), [torch.zeros(0)] * size, [None] * size
    peers = [Thread(rank, tensors, barrier) for rank in range(size)]

    def do(peer: Thread) -> None:
        try:
            found[peer.rank] = work(peer)
        finally:
            if found[peer.rank] is None:
                barrier.abort()

    threads = [threading.Thread(target=do, args=(peer,)) for peer in peers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


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
