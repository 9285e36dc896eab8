"""Types for what torch leaves untyped."""

from typing import Any, TypeAlias, TypedDict

import torch

# Any: torch keeps on it whatever ``forward`` sets.
Context: TypeAlias = Any


class TensorKind(TypedDict):
    """Keywords of ``torch.empty`` and the like. Given always: torch's defaults may be set by anybody."""

    dtype: torch.dtype
    device: torch.device


def kind_of(tensor: torch.Tensor) -> TensorKind:
    """That of another tensor."""
    return {"dtype": tensor.dtype, "device": tensor.device}
