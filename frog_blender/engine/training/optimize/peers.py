"""The processes that train one scene together, as the steps see them; ``session.processes`` connects them."""

from __future__ import annotations

from typing import Protocol

import torch

from ...errors import FrogError


class PeerLost(FrogError):
    """A process of the training has ended, or does not answer any more. What this one has learned is whole."""


class Peers(Protocol):
    """All processes of a training, each of which holds the whole scene and takes some views of every step.

    Every method that exchanges something has to be called by all of them in the same order.

    Attributes:
        rank: of this one, from 0. Rank 0 alone writes files and tells of the training.
        size: how many there are.
        decodes_first: whether this one is the first on its computer, which decodes the frames for all there.
    """

    rank: int
    size: int
    decodes_first: bool

    def add(self, tensor: torch.Tensor) -> None:
        """Makes ``tensor`` the sum over the processes, in place; PeerLost."""
        ...

    def maximum(self, tensor: torch.Tensor) -> None:
        """Makes ``tensor`` the largest of each number over the processes, in place; PeerLost."""
        ...


class Alone:
    """The one process of a plain training."""

    rank, size, decodes_first = 0, 1, True

    def add(self, tensor: torch.Tensor) -> None:
        """See Peers."""

    def maximum(self, tensor: torch.Tensor) -> None:
        """See Peers."""


ALONE = Alone()


def agreed(peers: Peers, wishes: tuple[bool, ...], facts: tuple[int, ...]) -> tuple[tuple[bool, ...], bool]:
    """What any process wishes, and whether ``facts`` are the same in all of them; PeerLost."""
    numbers = torch.tensor([*wishes, *facts, *(-fact for fact in facts)], dtype=torch.int64, device="cpu")
    peers.maximum(numbers)
    most, least = numbers[len(wishes) :].chunk(2)
    return tuple(bool(wish) for wish in numbers[: len(wishes)]), torch.equal(most, -least)


def shared(peers: Peers, content: bytes | None) -> bytes:
    """The ``content`` of rank 0, which alone has to have one; PeerLost."""
    size = torch.tensor([len(content or b"")], dtype=torch.int64, device="cpu")
    peers.add(size)
    array = torch.zeros(int(size), dtype=torch.uint8, device="cpu")
    if content:
        array.copy_(torch.frombuffer(bytearray(content), dtype=torch.uint8))
    peers.add(array)
    return array.numpy().tobytes()
