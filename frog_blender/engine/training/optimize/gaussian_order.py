"""Where Gaussians stand in their arrays: neighbours together, those at rest behind those that move. Everything in a
trainer that knows Gaussians by their places follows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from ...model.frog import total_deformation
from ...rasterizer import GaussianArrays
from ...scene.morton_order import morton_order_by_range
from ..compression.sensitivity import SampledView, mean_state

if TYPE_CHECKING:
    from .trainer import Trainer


@torch.no_grad()
def gaussians_at(trainer: Trainer, moment: float) -> GaussianArrays:
    """All Gaussians at a time in [0, 1], as training stands; what is done with them leaves the model no gradient."""
    gaussians = trainer.gaussians_at(moment, trainer.progress)[0]
    return GaussianArrays(*(value.detach() for value in vars(gaussians).values()))


def mean_dynamic_state(trainer: Trainer, looks: Sequence[SampledView]) -> dict[str, torch.Tensor]:
    """How those that move look on average over the looks, see motion.Measured.state."""
    state = mean_state(lambda moment: gaussians_at(trainer, moment), looks)
    return {name: values[: trainer.model.canonical.num_dynamic] for name, values in state.items()}


def mask_excluding(who: torch.Tensor, count: int) -> torch.Tensor:
    """(count,) true but for the indices ``who``."""
    keep = torch.ones(count, dtype=torch.bool, device=who.device)
    keep[who] = False
    return keep


def arrange(
    trainer: Trainer, who: torch.Tensor, movers: torch.Tensor, new: dict[str, torch.Tensor] | None = None
) -> None:
    """See SceneOptimizer.arrange; everything else in the trainer that knows Gaussians by their places follows."""
    trainer.optimizer.arrange(who, movers, new or {})
    trainer.density.arrange(who)
    if trainer.compression and trainer.compression.motion:
        trainer.compression.motion = trainer.compression.motion.of(movers)
    if trainer.neighbourhood is not None:
        trainer.find_neighbours()


def sort_by_morton_code(trainer: Trainer) -> None:
    """Steps are faster then: what a crop draws lies together in memory (docs/experiments/rasterizer.md)."""
    canonical = trainer.model.canonical
    order = morton_order_by_range(canonical.means.detach().cpu().numpy(), canonical.num_dynamic)
    who = torch.from_numpy(order).to(trainer.device)
    movers = who[: canonical.num_dynamic]
    trainer.optimizer.arrange(who, movers, {})
    trainer.density.arrange(who)
    if trainer.neighbourhood is not None:
        trainer.neighbourhood = trainer.neighbourhood.arranged(movers)


def freeze_motion(trainer: Trainer, who: torch.Tensor, state: dict[str, torch.Tensor]) -> None:
    """Lets moving Gaussians ``who`` (indices, ascending) look at all times as in ``state`` (see motion.Measured)."""
    canonical = trainer.model.canonical
    for name, values in state.items():
        parameter = getattr(canonical, name).data
        if name == "sh":  # degrees that have not begun, or were cut
            count = min(parameter.shape[1], values.shape[1])
            parameter, values = parameter[:, :count], values[:, :count]
        parameter[who] = values[who]
    movers = mask_excluding(who, canonical.num_dynamic).nonzero().squeeze(1)
    still = torch.arange(canonical.num_dynamic, trainer.count, device=who.device)
    arrange(trainer, torch.cat([movers, who, still]), movers)


@torch.no_grad()
def wake(trainer: Trainer, who: torch.Tensor) -> None:
    """Lets Gaussians at rest ``who`` (indices, ascending) move, as the calmest of those that move does at first."""
    canonical = trainer.model.canonical
    embedding = canonical.embeddings.new_zeros(1, canonical.embeddings.shape[1])
    if canonical.num_dynamic:
        changes = trainer.gaussians_at(0.5, trainer.progress)[1]
        embedding = canonical.embeddings.detach()[int(total_deformation(changes).argmin())][None]
    everyone = torch.arange(trainer.count, device=who.device)
    still = mask_excluding(who, trainer.count)
    still[: canonical.num_dynamic] = False
    order = torch.cat([everyone[: canonical.num_dynamic], who, everyone[still]])
    movers = torch.arange(canonical.num_dynamic + len(who), device=who.device)
    arrange(trainer, order, movers, {"embeddings": embedding.expand(len(who), -1)})
