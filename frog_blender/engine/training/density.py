"""Adaptive density control: Gaussians that the pictures pull at are split or cloned, invisible ones removed.

The rules of 3DGS, without its opacity reset (which costs dynamic scenes; E-D3DGS never resets), and with a budget:
each round takes the strongest candidates until the recipe's growth or its Gaussian limit is reached.
"""

from __future__ import annotations

import torch

from ..capture.camera import Camera
from ..model.canonical import ATTRIBUTES, CanonicalField
from ..rasterizer import Image
from ..rasterizer.reference import rotation_matrices
from .fitting import fitting
from .optimizer import SceneOptimizer
from .recipe import Recipe

_GROWTH_WHILE_FEW = 1.0  # every candidate may grow


class DensityControl:
    """Collects screen gradients between rounds.

    Args:
        recipe: thresholds.
        scene_scale: world units.
        count: Gaussians.
        device: theirs.
    """

    def __init__(self, recipe: Recipe, scene_scale: float, count: int, device: torch.device | str = "cpu") -> None:
        self.recipe = recipe
        self._scene_scale = scene_scale
        self.peak_opacity = torch.ones(count, device=device)
        self.reset(torch.arange(count, device=device))

    def reset(self, who: torch.Tensor) -> None:
        """Begins again with the Gaussians ``who``: old indices, those beyond the old count for new ones."""
        device = self.peak_opacity.device
        self.gradient_sum = torch.zeros(len(who), device=device)
        self.seen = torch.zeros(len(who), device=device)
        # Fades over several rounds: one round's steps may miss the moment at which a Gaussian is seen.
        count = len(self.peak_opacity)
        faded = torch.cat([0.5 * self.peak_opacity, torch.ones(1, device=device)])
        self.peak_opacity = faded[who.clamp(max=count)]

    def resume(self, count: int, gradient_sum: torch.Tensor, seen: torch.Tensor, peak_opacity: torch.Tensor) -> None:
        """Goes on from what was collected of ``count`` Gaussians; ValueError for arrays that do not fit."""
        device = self.peak_opacity.device
        self.gradient_sum = fitting("gradient_sum", gradient_sum, (count,)).to(device)
        self.seen = fitting("seen", seen, (count,)).to(device)
        self.peak_opacity = fitting("peak_opacity", peak_opacity, (count,)).to(device)

    @torch.no_grad()
    def observe(self, image: Image, opacities: torch.Tensor, camera: Camera) -> None:
        """Adds one backward pass of ``camera`` and the opacities (N,) it drew; call it before the optimiser clears the
        gradients."""
        torch.maximum(self.peak_opacity, opacities, out=self.peak_opacity)
        if image.screen.grad is None:
            return
        half = max(camera.width, camera.height) / 2  # 3DGS counts in half picture widths
        across, down = image.screen.grad.unbind(1)  # zero where nothing was seen
        self.gradient_sum.add_((across * across).addcmul_(down, down).sqrt_(), alpha=half)
        self.seen += image.radii > 0

    @torch.no_grad()
    def round(
        self, canonical: CanonicalField, optimizer: SceneOptimizer, generator: torch.Generator
    ) -> tuple[int, int]:
        """One round of growth and pruning; returns how many came and how many went."""
        recipe, count = self.recipe, len(canonical)
        # What is seen at one moment only is nearly transparent in the canonical field, and must stay.
        keep = self.peak_opacity > recipe.prune_opacity
        keep |= ~keep.any()  # never everything
        pull = self.gradient_sum / self.seen.clamp(min=1)
        room = min(
            recipe.newcomers(count, recipe.densify_growth, _GROWTH_WHILE_FEW), recipe.max_gaussians - int(keep.sum())
        )
        chosen = torch.empty(0, dtype=torch.long, device=keep.device)
        if room > 0:
            candidates = ((pull > recipe.densify_threshold) & keep).nonzero().squeeze(1)
            chosen = candidates[pull[candidates].topk(min(room, len(candidates))).indices].sort().values

        # In order of their indices: first those that move, as their copies will. A parent at rest has copies at rest.
        values = {name: getattr(canonical, name).detach()[chosen] for name in ATTRIBUTES if name != "embeddings"}
        values["embeddings"] = canonical.embeddings.detach()[chosen[chosen < canonical.moving]]
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
        self.reset(optimizer.replace_gaussians(kept, new))
        return len(chosen), count - int(keep.sum())
