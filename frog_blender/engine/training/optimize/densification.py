"""Adaptive density control: Gaussians with large screen gradients are split or cloned, invisible ones pruned.

The rules of 3DGS, without its opacity reset (which costs dynamic scenes; E-D3DGS never resets), and with a budget:
each round takes the strongest candidates until the recipe's growth or its Gaussian limit is reached. At the limit they
replace those of the least blending weights: seed points lie where nothing is seen, too.
"""

from __future__ import annotations

import math

import torch

from ...capture.camera import Camera
from ...cuda import launch
from ...cuda.sources import kernel
from ...model.canonical import ATTRIBUTES
from ...rasterizer import Image
from ...rasterizer.reference import rotation_matrices
from ...recipes import Recipe
from .gaussian_state import GaussianState, Reindexing
from .stateful import Tensors, Values, expect

COLLECTED = {"gradient_sum": 0.0, "seen": 0.0, "peak_opacity": 1.0, "peak_weight": 1.0}
"""Statistics kept by Gaussian, by attribute of ``DensificationStrategy``, and their values at the start."""

_GROWTH_WHILE_FEW = 1.0  # every candidate may grow
# Peaks decay over several rounds: the steps of one round may miss the time, or the crop, at which a Gaussian is seen.
_OPACITY_DECAY, _WEIGHT_DECAY = 0.5, 0.6
_FULL_ROUND = 25  # observations of a Gaussian: weights decay by less after a round with fewer


class DensityStrategy:
    """Who adds and removes Gaussians: made of the Gaussians, the recipe and the scene's scale (world units).

    Statistics are collected here whatever a strategy makes of them. A strategy of another kind is a subclass with a
    ``round`` of its own; ``DensificationStrategy`` is ours.

    Attributes:
        gradient_sum, seen: (N,) screen gradients since the last round, and how many.
        peak_opacity: (N,) the largest recent opacity, seen or not.
        peak_weight: (N,) the largest recent blending weight.

    Args:
        gaussians: to follow.
        recipe: thresholds.
        scene_scale: world units.
    """

    gradient_sum: torch.Tensor
    seen: torch.Tensor
    peak_opacity: torch.Tensor
    peak_weight: torch.Tensor

    def __init__(self, gaussians: GaussianState, recipe: Recipe, scene_scale: float) -> None:
        self.recipe = recipe
        self._canonical, self._scene_scale = gaussians.canonical, scene_scale
        for name, first in COLLECTED.items():
            setattr(self, name, torch.full((gaussians.count,), first, device=gaussians.device))
        gaussians.register(self.reindex)

    @torch.no_grad()
    def observe(
        self,
        image: Image,
        opacities: torch.Tensor,
        camera: Camera,
        ignored: torch.Tensor | None = None,
        state: torch.Tensor | None = None,
    ) -> None:
        """Adds one backward pass of ``camera`` and the opacities (N,) it drew; call it before the optimiser clears the
        gradients.

        Args:
            ignored: (N,) bool, Gaussians in pixels that do not count: that they are drawn says nothing of their use.
            state: on a GPU, of the drawing, see ``RasterPass``: nothing is added where its pairs had no room.
        """
        half = max(camera.width, camera.height) / 2  # 3DGS counts in half image widths
        if launch.on_gpu(opacities):
            given = opacities.contiguous(), image.max_weights, image.screen.grad, image.radii, ignored, half, state
            collected = self.peak_opacity, self.peak_weight, self.gradient_sum, self.seen
            launcher, count = launch.launcher_for(opacities.device), len(opacities)
            launcher.launch(kernel("observe"), launch.blocks_for(count), count, *given, *collected)
            return
        torch.maximum(self.peak_opacity, opacities, out=self.peak_opacity)
        if image.max_weights is not None:
            weights = image.max_weights if ignored is None else image.max_weights.masked_fill(ignored, 0)
            torch.maximum(self.peak_weight, weights, out=self.peak_weight)
        if image.screen.grad is None:
            return
        across, down = image.screen.grad.unbind(1)  # zero where nothing was seen
        self.gradient_sum.add_((across * across).addcmul_(down, down).sqrt_(), alpha=half)
        self.seen += image.radii > 0 if ignored is None else (image.radii > 0) & ~ignored

    def round(self, gaussians: GaussianState, limit: int, generator: torch.Generator) -> tuple[int, int]:
        """One round, ``recipe.densify_every`` after the last; returns how many were added and removed.

        Args:
            gaussians: to change by ``replace``, ``keep`` and ``reindex``.
            limit: Gaussians at most, afterwards.
            generator: of random numbers, so that a seed decides them.
        """
        raise NotImplementedError

    def reindex(self, change: Reindexing) -> None:
        """See ``GaussianState.register``."""
        for name, first in COLLECTED.items():
            old = getattr(self, name)
            setattr(self, name, torch.cat([old, old.new_full((1,), first)])[change.indices.clamp(max=len(old))])

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {f"density.{name}": getattr(self, name) for name in COLLECTED}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        for name in COLLECTED:
            statistic = expect(name, tensors[f"density.{name}"], (len(self._canonical),), within=(0, math.inf))
            setattr(self, name, statistic.to(self._canonical.means.device))

    def least_needed(self, count: int, among: torch.Tensor | None = None) -> torch.Tensor:
        """Indices of at most ``count`` Gaussians, of all or ``among`` (N,), that may be replaced: those of the least
        blending weights, all below the recipe's ``replaced_below``."""
        weights = self.peak_weight if among is None else torch.where(among, self.peak_weight, torch.inf)
        least = weights.topk(min(max(count, 0), len(weights)), largest=False)
        return least.indices[least.values < self.recipe.replaced_below]


class DensificationStrategy(DensityStrategy):
    """That of 3DGS; see the module."""

    @torch.no_grad()
    def round(self, gaussians: GaussianState, limit: int, generator: torch.Generator) -> tuple[int, int]:
        """One round of growth, to ``limit`` Gaussians at most, and pruning; returns how many were added and removed."""
        recipe, count, canonical = self.recipe, gaussians.count, gaussians.canonical
        # What is seen at one time only is nearly transparent in the canonical field, and must stay.
        keep = self.peak_opacity > recipe.prune_opacity
        keep |= ~keep.any()  # never everything
        gradient = self.gradient_sum / self.seen.clamp(min=1)
        candidates = ((gradient > recipe.densify_threshold) & keep).nonzero().squeeze(1)
        num_new = min(recipe.num_new(count, recipe.densify_growth, _GROWTH_WHILE_FEW), len(candidates))
        chosen = candidates[gradient[candidates].topk(num_new).indices]
        room = max(limit - int(keep.sum()), 0)
        if num_new > room:
            replaced = self.least_needed(num_new - room, keep.index_fill(0, chosen, False))
            keep[replaced] = False
            chosen = chosen[: room + len(replaced)]  # the strongest
        chosen = chosen.sort().values

        # In order of their indices: dynamic ones first. Copies of static Gaussians are static.
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
        observed = float(self.seen.max())
        gaussians.replace(kept, new)
        self.gradient_sum.zero_()
        self.seen.zero_()
        self.peak_opacity *= _OPACITY_DECAY
        self.peak_weight *= _WEIGHT_DECAY ** min(1.0, observed / _FULL_ROUND)
        return len(chosen), count - int(keep.sum())
