"""Fusing the coarse and the fine temporal embedding (FRoG, section on early fusion, and its table of variants)."""

from __future__ import annotations

import torch


def fuse(
    form: str, coarse: torch.Tensor, fine: torch.Tensor, attention: tuple[torch.Tensor, torch.Tensor] | None = None
) -> torch.Tensor:
    """(networks, fused size) what the networks are given at a time.

    Args:
        form: one of field.names.FUSIONS.
        coarse, fine: (T,) embeddings of the time.
        attention: weight (A, T) and query (A,): the score of t is query . tanh(weight t).
    """
    if form == "dual":
        return torch.stack([coarse, fine])
    if form == "product":
        fused = coarse * fine
    elif form == "add":
        fused = coarse + fine
    elif form == "concat":
        fused = torch.cat([coarse, fine])
    elif form == "attention":
        assert attention is not None
        weight, query = attention
        both = torch.stack([coarse, fine])
        fused = torch.softmax(torch.tanh(both @ weight.T) @ query, dim=0) @ both
    else:
        fused = coarse if form == "coarse" else fine
    return fused[None]
