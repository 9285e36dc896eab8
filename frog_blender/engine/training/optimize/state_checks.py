"""What a checkpoint holds is looked at before it is taken over: native code only sees addresses."""

from __future__ import annotations

import torch


def fitting(name: str, found: torch.Tensor, shape: tuple[int, ...], dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """``found`` itself; ValueError unless it has this shape and type."""
    if found.shape != shape or found.dtype != dtype:
        raise ValueError(f"{name} is {found.dtype} of {tuple(found.shape)} instead of {dtype} of {tuple(shape)}")
    return found
