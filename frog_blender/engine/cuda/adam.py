"""A step of Adam for all parameters in one launch on an NVIDIA GPU."""

from collections.abc import Sequence
from ctypes import Structure, c_int32
from itertools import accumulate

import torch

from ..native import structs
from . import launch
from .sources import kernel

_MOST, _SHARE = 24, 1024  # parameters of a launch, and numbers of a block; as in adam.cu


class _Steps(Structure):
    _fields_ = (("each", structs.Adam * _MOST), ("first_block", c_int32 * (_MOST + 1)))


def step(device: torch.device, parameters: Sequence[Structure], state: torch.Tensor | None = None) -> None:
    """Moves parameters and what is remembered of them.

    Args:
        device: where everything lies.
        parameters: ``structs.Adam``.
        state: of the drawing that the gradients come from, see ``RasterPass``: nothing is moved where its pairs had no
            room.
    """
    for start in range(0, len(parameters), _MOST):
        some = parameters[start : start + _MOST]
        ends = list(accumulate(-(-each.size // _SHARE) for each in some))
        blocks = (c_int32 * (_MOST + 1))(0, *ends, *[ends[-1]] * (_MOST - len(some)))
        launch.launcher_for(device).launch(
            kernel("adam"), ends[-1], _Steps((structs.Adam * _MOST)(*some), blocks), state
        )
