"""Gaussians that a training draws with but keeps as they are, since other trainings share them.

They are static, and lie among the training's own in any order. Nothing prunes, copies or moves them, and after each
step they get their values back, to the bit.
"""

from __future__ import annotations

import torch

from ...model.canonical import ATTRIBUTES, CanonicalField
from .stateful import Tensors, expect

SHARED_ATTRIBUTES = tuple(name for name in ATTRIBUTES if name != "embeddings")


class FixedGaussians:
    """Which Gaussians are fixed, and what they are.

    Args:
        canonical: whose last rows they are at first.
        values: (F, ...) by the names in SHARED_ATTRIBUTES.

    Attributes:
        mask: (N,) bool, true where a Gaussian is fixed.
    """

    def __init__(self, canonical: CanonicalField, values: Tensors) -> None:
        self._canonical, self._values = canonical, values
        free = len(canonical) - len(values["means"])
        which = torch.arange(len(canonical), device=canonical.means.device) - free
        self._follow(which.clamp(min=-1))

    def __len__(self) -> int:
        return len(self._values["means"])

    def reindex(self, indices: torch.Tensor) -> None:
        """Follows a change of the rows; see ``Reindexing.indices``. ValueError where one is lost, or comes twice."""
        which = torch.cat([self._which, self._which.new_full((1,), -1)])
        self._follow(which[indices.clamp(max=len(self._which))])

    def restore(self) -> None:
        """Gives them their values back."""
        for name, values in self._kept.items():
            getattr(self._canonical, name).data.index_copy_(0, self._rows, values)

    def state(self) -> Tensors:
        """For a checkpoint: (N,) which of the values each Gaussian has, -1 for none."""
        return {"fixed.which": self._which}

    def load_state(self, tensors: Tensors) -> None:
        """What ``state`` gave; ValueError for what does not fit."""
        which = expect("fixed.which", tensors["fixed.which"], (len(self._canonical),), torch.int64)
        self._follow(which.to(self._canonical.means.device))

    def _follow(self, which: torch.Tensor) -> None:
        rows = (which >= 0).nonzero().squeeze(1)
        order = which[rows]
        if not torch.equal(order.sort().values, torch.arange(len(self), device=which.device)):
            raise ValueError(f"{len(rows)} fixed Gaussians, expected each of {len(self)} once")
        if bool((which[: self._canonical.num_dynamic] >= 0).any()):
            raise ValueError("fixed Gaussians that are dynamic")
        self._which, self._rows, self.mask = which, rows, which >= 0
        self._kept = {name: self._values[name][order] for name in SHARED_ATTRIBUTES}
