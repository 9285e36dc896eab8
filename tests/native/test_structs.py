"""Addresses that native code is given."""

import numpy as np
import pytest
import torch

from frog_blender.engine.native.structs import address

NUMBERS = np.arange(12, dtype=np.float32).reshape(3, 4)


def read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


@pytest.mark.parametrize(
    "array", [NUMBERS, NUMBERS[1:], NUMBERS[0, 0:0], NUMBERS[:, 1], NUMBERS.T, read_only(NUMBERS), np.float32([])]
)
def test_an_address_is_where_an_array_lies(array: np.ndarray) -> None:
    assert address(array) == array.ctypes.data


def test_no_array_has_no_address_and_a_tensor_its_own() -> None:
    tensor = torch.ones(2, 3)
    assert address(None) is None and address(tensor) == tensor.data_ptr()


def test_memory_can_be_given_back_afterwards() -> None:
    """Nothing holds on to what was asked for an address (see playback.buffer_pool)."""
    block = bytearray(8)
    assert address(np.frombuffer(block, np.float32)) is not None
    block.append(0)
