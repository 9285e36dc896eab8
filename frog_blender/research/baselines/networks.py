"""What the baselines' networks share: their backward pass, what becomes of the Gaussians, and the box of a scene.

Most steps draw a part of an image, and most Gaussians send no gradient back. What a baseline's network says of one
Gaussian depends on no other, so the pass forwards keeps nothing, and the pass backwards repeats it for the few rows
that matter (as FRoG's native one leaves the others out): the same gradients for a fraction of the time.
"""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import torch
from torch import nn

from ...engine import FINISHED, CanonicalField, Context, Deformed, GaussianArrays, JsonObject, SceneModel, ScheduleState


class _VisibleRows(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Context, network: nn.Module, time: float, means: torch.Tensor, *parameters: torch.Tensor
    ) -> torch.Tensor:
        ctx.network, ctx.time = network, time
        ctx.save_for_backward(means, *parameters)
        result: torch.Tensor = network(means, time)
        return result

    @staticmethod
    def backward(ctx: Context, *by: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        means, *parameters = ctx.saved_tensors
        (gradient,) = by
        rows = gradient.any(dim=1).nonzero().squeeze(1)
        wants_means = ctx.needs_input_grad[2]
        some = means[rows].requires_grad_(wants_means)
        with torch.enable_grad():
            output = ctx.network(some, ctx.time)
        inputs = [*parameters, some] if wants_means else parameters
        gradients = list(torch.autograd.grad(output, inputs, gradient[rows]))
        to_means = None
        if wants_means:
            to_means = torch.zeros_like(means)
            to_means[rows] = gradients.pop()
        return None, None, to_means, *gradients


def through_visible_rows(network: nn.Module, means: torch.Tensor, time: float) -> torch.Tensor:
    """``network(means, time)``, (N, outputs) of means (N, 3); every parameter of the network must take part in it."""
    apply: Callable[..., torch.Tensor] = _VisibleRows.apply
    return apply(network, time, means, *network.parameters())


class Baseline(SceneModel):
    """A model of canonical Gaussians and settings, a dataclass, which the scene file keeps."""

    def __init__(self, canonical: CanonicalField, settings: Any) -> None:
        super().__init__()
        self.canonical: CanonicalField = canonical
        self.settings = settings

    def stored_settings(self, schedule_state: ScheduleState) -> JsonObject:
        return asdict(self.settings)


class NetworkBaseline(Baseline):
    """One whose network ``deformation``, of means and time, puts out changes of ``settings.sizes``, means in motion
    units."""

    deformation: nn.Module

    def places(self) -> torch.Tensor:
        """(N, 3) what the network is given."""
        return self.canonical.means

    def deform(self, time: float, schedule_state: ScheduleState = FINISHED) -> Deformed:
        """See SceneModel."""
        output, sizes = through_visible_rows(self.deformation, self.places(), time), self.settings.sizes
        changes = dict(zip(sizes, output.split(list(sizes.values()), dim=1), strict=True))
        changes["means"] = changes["means"] * self.settings.motion_unit
        c = self.canonical
        opacity_logits, sh = c.opacity_logits, c.sh
        if "opacity_logits" in changes:
            opacity_logits = opacity_logits + changes["opacity_logits"].squeeze(1)
        if "sh" in changes:  # of the first coefficients
            d_sh = changes["sh"].reshape(len(c), -1, 3)
            count = d_sh.shape[1]
            sh = torch.cat([sh[:, :count] + d_sh, sh[:, count:]], dim=1)
        gaussians = GaussianArrays(
            c.means + changes["means"],
            c.quaternions + changes["quaternions"],
            (c.log_scales + changes["log_scales"]).exp(),
            opacity_logits.sigmoid(),
            sh[:, : schedule_state.sh_count],
            low_pass=c.low_pass,
        )
        return gaussians, changes


def bounds_of(points: torch.Tensor, margin: float = 0.1) -> tuple[torch.Tensor, torch.Tensor]:
    """Lower and upper corner (3,), on the CPU, of a box that a few stray points cannot blow up.

    From the first to the ninety-ninth hundredth of each coordinate, and ``margin`` of its sides more on each side.
    """
    ordered = points.detach().cpu().sort(dim=0).values
    last = len(ordered) - 1
    low, high = ordered[round(0.01 * last)], ordered[round(0.99 * last)]
    room = margin * (high - low) + 1e-6 * (1 + low.abs())  # never flat
    return low - room, high + room
