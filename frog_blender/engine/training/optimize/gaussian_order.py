"""Where Gaussians stand in their arrays: neighbours together, static ones behind dynamic ones."""

from __future__ import annotations

import torch

from ...model.frog import total_deformation
from ...scene.morton_order import morton_order_by_range
from .gaussian_state import GaussianState
from .stateful import Tensors


def mask_excluding(indices: torch.Tensor, count: int) -> torch.Tensor:
    """(count,) true but for ``indices``."""
    keep = torch.ones(count, dtype=torch.bool, device=indices.device)
    keep[indices] = False
    return keep


def sort_by_morton_code(gaussians: GaussianState) -> None:
    """Makes steps faster, those on crops most: what they draw lies together (docs/experiments)."""
    order = morton_order_by_range(gaussians.canonical.means.detach().cpu().numpy(), gaussians.num_dynamic)
    gaussians.reindex(torch.from_numpy(order).to(gaussians.device), gaussians.num_dynamic, resample=False)


def freeze_motion(gaussians: GaussianState, indices: torch.Tensor, state: Tensors) -> None:
    """Makes dynamic Gaussians static.

    Args:
        indices: of dynamic ones, ascending.
        state: how all dynamic ones look from now on, see ``Sensitivity.state``.
    """
    for name, values in state.items():
        parameter = getattr(gaussians.canonical, name).data
        if name == "sh":  # degrees that have not begun, or were cut
            count = min(parameter.shape[1], values.shape[1])
            parameter, values = parameter[:, :count], values[:, :count]
        parameter[indices] = values[indices]
    dynamic = mask_excluding(indices, gaussians.num_dynamic).nonzero().squeeze(1)
    static = torch.arange(gaussians.num_dynamic, gaussians.count, device=indices.device)
    gaussians.reindex(torch.cat([dynamic, indices, static]), len(dynamic))


def calmest_embedding(gaussians: GaussianState, changes: Tensors) -> torch.Tensor:
    """(E,) of the Gaussian that ``changes`` (see ``SceneModel.deform``) deform least; zeros where none is dynamic."""
    embeddings = gaussians.canonical.embeddings.detach()
    if not len(embeddings):
        return embeddings.new_zeros(embeddings.shape[1])
    return embeddings[int(total_deformation(changes).argmin())]
