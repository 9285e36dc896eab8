"""What a part of a training gives to a checkpoint and takes back from one.

What comes back is checked before it is taken over: native code only sees addresses.
"""

from typing import Protocol

import torch

from ...io.plain_values import JsonObject

Tensors = dict[str, torch.Tensor]
"""Arrays by their names in a checkpoint."""
Values = JsonObject
"""Plain values by their names in a checkpoint."""


class Stateful(Protocol):
    """A part of a training that a checkpoint holds. The names of what it gives are its own alone."""

    def state(self) -> tuple[Tensors, Values]:
        """What ``load_state`` needs; nothing of it is a copy."""

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """Takes its own out of all that a checkpoint holds, on the CPU. Any exception for what does not fit."""


def expect(
    name: str,
    tensor: torch.Tensor,
    shape: tuple[int, ...],
    dtype: torch.dtype = torch.float32,
    within: tuple[float, float] | None = None,
) -> torch.Tensor:
    """``tensor`` itself; ValueError unless it has this shape and type, and numbers ``within`` these two where given."""
    if tensor.shape != shape or tensor.dtype != dtype:
        raise ValueError(f"{name} is {tensor.dtype} of {tuple(tensor.shape)} instead of {dtype} of {tuple(shape)}")
    if within is not None and not bool(((tensor >= within[0]) & (tensor <= within[1])).all()):
        raise ValueError(f"{name} has numbers that are not from {within[0]} to {within[1]}")
    return tensor
