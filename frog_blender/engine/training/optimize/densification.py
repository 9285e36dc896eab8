"""Adaptive density control: Gaussians that the images pull at are split or cloned, invisible ones removed.

The rules of 3DGS, without its opacity reset (which costs dynamic scenes; E-D3DGS never resets), and with a budget:
each round takes the strongest candidates until the recipe's growth or its Gaussian limit is reached. At the limit they
take the places of those that images need least: seeds lie where nothing is to be seen, too.
"""

from __future__ import annotations

import torch

from ...capture.camera import Camera
from ...model.canonical import ATTRIBUTES, CanonicalField
from ...rasterizer import Image
from ...rasterizer.reference import rotation_matrices
from ..recipe import Recipe
from .optimizer import SceneOptimizer
from .state_checks import fitting

COLLECTED = {"gradient_sum": 0.0, "seen": 0.0, "peak_opacity": 1.0, "peak_weight": 1.0}
"""Statistics kept by Gaussian, by attribute of ``DensificationStrategy``, and their values at the start."""

_GROWTH_WHILE_FEW = 1.0  # every candidate may grow
# Peaks fade from round to round, over several of them: one round's steps may miss the moment, or the part of an image,
# at which a Gaussian is seen.
_FADING_OPACITY, _FADING_WEIGHT = 0.5, 0.6
_LOOKS = 25  # a round with fewer looks at a Gaussian than that lets weights fade by less: nobody was missed yet


class DensificationStrategy:
    """Collects screen gradients between rounds.

    Args:
        recipe: thresholds.
        scene_scale: world units.
        count: Gaussians.
        device: theirs.

    Attributes:
        gradient_sum, seen: (N,) screen gradients since the last round, and how many.
        peak_opacity: (N,) the largest opacity of late, seen or not.
        peak_weight: (N,) the largest blending weight of late.
    """

    gradient_sum: torch.Tensor
    seen: torch.Tensor
    peak_opacity: torch.Tensor
    peak_weight: torch.Tensor

    def __init__(self, recipe: Recipe, scene_scale: float, count: int, device: torch.device | str = "cpu") -> None:
        self.recipe = recipe
        self._scene_scale = scene_scale
        for name, first in COLLECTED.items():
            setattr(self, name, torch.full((count,), first, device=device))

    def arrange(self, who: torch.Tensor) -> None:
        """Goes on with the Gaussians ``who``: old indices, those beyond the old count for new ones."""
        for name, first in COLLECTED.items():
            old = getattr(self, name)
            setattr(self, name, torch.cat([old, old.new_full((1,), first)])[who.clamp(max=len(old))])

    def resume(self, arrays: dict[str, torch.Tensor], count: int) -> None:
        """Goes on from what was collected of ``count`` Gaussians, by name; ValueError for arrays that do not fit."""
        for name in COLLECTED:
            found = fitting(name, arrays[name], (count,))
            if not bool((found >= 0).all()):
                raise ValueError(f"{name} below zero")
            setattr(self, name, found.to(self.seen.device))

    @torch.no_grad()
    def observe(self, image: Image, opacities: torch.Tensor, camera: Camera) -> None:
        """Adds one backward pass of ``camera`` and the opacities (N,) it drew; call it before the optimiser clears the
        gradients."""
        torch.maximum(self.peak_opacity, opacities, out=self.peak_opacity)
        if image.max_weights is not None:
            torch.maximum(self.peak_weight, image.max_weights, out=self.peak_weight)
        if image.screen.grad is None:
            return
        half = max(camera.width, camera.height) / 2  # 3DGS counts in half image widths
        across, down = image.screen.grad.unbind(1)  # zero where nothing was seen
        self.gradient_sum.add_((across * across).addcmul_(down, down).sqrt_(), alpha=half)
        self.seen += image.radii > 0

    def least_needed(self, count: int, among: torch.Tensor | None = None) -> torch.Tensor:
        """Indices of at most ``count`` Gaussians, of all or ``among`` (N,), that may make room for others: those of the
        least blending weights, all below the recipe's ``replaced_below``."""
        weights = self.peak_weight if among is None else torch.where(among, self.peak_weight, torch.inf)
        least = weights.topk(min(max(count, 0), len(weights)), largest=False)
        return least.indices[least.values < self.recipe.replaced_below]

    @torch.no_grad()
    def round(
        self, canonical: CanonicalField, optimizer: SceneOptimizer, limit: int, generator: torch.Generator
    ) -> tuple[int, int]:
        """One round of growth, to ``limit`` Gaussians at most, and pruning; returns how many came and how many went."""
        recipe, count = self.recipe, len(canonical)
        # What is seen at one moment only is nearly transparent in the canonical field, and must stay.
        keep = self.peak_opacity > recipe.prune_opacity
        keep |= ~keep.any()  # never everything
        pull = self.gradient_sum / self.seen.clamp(min=1)
        candidates = ((pull > recipe.densify_threshold) & keep).nonzero().squeeze(1)
        wanted = min(recipe.num_new(count, recipe.densify_growth, _GROWTH_WHILE_FEW), len(candidates))
        chosen = candidates[pull[candidates].topk(wanted).indices]
        room = max(limit - int(keep.sum()), 0)
        if wanted > room:
            replaced = self.least_needed(wanted - room, keep.index_fill(0, chosen, False))
            keep[replaced] = False
            chosen = chosen[: room + len(replaced)]  # the strongest
        chosen = chosen.sort().values

        # In order of their indices: first those that move, as their copies will. A parent at rest has copies at rest.
        values = {name: getattr(canonical, name).detach()[chosen] for name in ATTRIBUTES if name != "embeddings"}
        values["embeddings"] = canonical.embeddings.detach()[chosen[chosen < canonical.num_dynamic]]
        large = values["log_scales"].exp().amax(1) > recipe.split_scale * self._scene_scale
        # Split: two samples of the old Gaussian, 1.6 times smaller, in its place. Clone: the same one twice.
        shrink = torch.where(large, torch.tensor(1.6, device=large.device).log(), 0.0)[:, None]
        offsets = torch.randn(values["means"].shape, generator=generator).to(large.device)
        offsets = offsets * values["log_scales"].exp() * large[:, None]
        offsets = (rotation_matrices(values["quaternions"]) @ offsets[:, :, None]).squeeze(2)
        new = dict(values, means=values["means"] + offsets, log_scales=values["log_scales"] - shrink)
        canonical.means.data[chosen] -= offsets
        canonical.log_scales.data[chosen] -= shrink
        kept = keep.nonzero().squeeze(1)
        looks = float(self.seen.max())
        self.arrange(optimizer.replace_gaussians(kept, new))
        self.gradient_sum.zero_()
        self.seen.zero_()
        self.peak_opacity *= _FADING_OPACITY
        self.peak_weight *= _FADING_WEIGHT ** min(1.0, looks / _LOOKS)
        return len(chosen), count - int(keep.sum())
