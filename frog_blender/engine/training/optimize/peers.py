"""The processes that share a training's steps: what a step asks of them, and a training that is alone."""

from __future__ import annotations

from typing import Protocol

import torch

from ...errors import FrogError


class PeerLost(FrogError):
    """A process that shares the training has ended or does not answer."""


class Peers(Protocol):
    """The processes of one training. Every method is called by all of them, in the same order.

    Each raises PeerLost where one of them is gone.
    """

    @property
    def rank(self) -> int:
        """Of this process, from 0; the first one writes what there is to write."""
        ...

    @property
    def size(self) -> int:
        """How many processes there are."""
        ...

    @property
    def is_first_here(self) -> bool:
        """Whether this is the first process of its machine: the one that decodes images for the others."""
        ...

    def add_up(self, values: torch.Tensor) -> None:
        """Replaces values by their sums over the processes, with the same bits in each of them."""
        ...

    def take_largest(self, values: torch.Tensor) -> None:
        """Replaces values by the largest of any process."""
        ...

    def gather(self, row: list[int]) -> list[list[int]]:
        """The rows of all processes, which are of one length, by rank."""
        ...

    def first_of(self, value: float) -> float:
        """The first process's value."""
        ...

    def from_first(self, content: bytes) -> bytes:
        """The first process's content; what the others give is not looked at."""
        ...


class Alone:
    """A training in one process."""

    rank, size, is_first_here = 0, 1, True

    def add_up(self, values: torch.Tensor) -> None:
        """See Peers."""

    def take_largest(self, values: torch.Tensor) -> None:
        """See Peers."""

    def gather(self, row: list[int]) -> list[list[int]]:
        """See Peers."""
        return [row]

    def first_of(self, value: float) -> float:
        """See Peers."""
        return value

    def from_first(self, content: bytes) -> bytes:
        """See Peers."""
        return content
