"""The deformation field: one small network from (temporal embedding, Gaussian embedding) to attribute changes.

Its first layer separates, W [t; e] + b = (W_t t + b) + W_e e, so the N x (T + E) concatenation is never built:
``W_t t + b`` is one vector for all Gaussians, and ``W_e e`` does not depend on time at all (playback caches it).

With modulation, which no paper of this family has, the embedding's weights follow time as well,
(W_e + W_m diag(t - 1)) e, so that a unit sees products of temporal and Gaussian embedding beside their sum. With the
sum alone, a Gaussian that learns its motion at one time is disturbed at the others. It costs one matrix of weights a
frame and nothing a Gaussian.

Before it stands the fusion of coarse and fine temporal embedding, behind it the aggressive opacity reduction, opacity =
sigmoid(logit + d) * factor(k d) (FRoG, sections of these names).
"""

from dataclasses import dataclass

import torch
from torch import nn

from ..field.names import fused_size, network_count
from ..field.network import output_sizes


@dataclass(frozen=True)
class FrogSettings:
    """The shape of the model; written into the scene file, since playback needs it.

    Attributes:
        temporal_rows, coarse_rows: rows of the table, and rows it is resampled to for the coarse embedding.
        temporal_size, embedding_size: lengths of t and e.
        hidden_width, head_width: of the first layer, and of each head's hidden layer (the paper has five of 128);
            0 shares the first layer among all heads, which gave the same PSNR at a third of the time.
        deformed_sh: SH coefficients that deform (0 to K).
        opacity_reduction, opacity_sharpness: see the module.
        fusion: of the coarse and the fine temporal embedding, see ``field.network.fuse``.
        modulation: see the module.
        deformed_opacity: False leaves opacities as they are at every time (and there is nothing to reduce).
        motion_unit: world units that a network output of one moves a Gaussian by (makes rates independent of the
            capture's units).
        fine_rows, opacity_share: how far the schedules had come when the scene was written; all rows (0) and 1 unless
            training was stopped early.
    """

    temporal_rows: int
    coarse_rows: int
    temporal_size: int = 64
    embedding_size: int = 32
    hidden_width: int = 64
    head_width: int = 0
    deformed_sh: int = 1
    opacity_reduction: str = "unit"
    opacity_sharpness: float = 10.0
    motion_unit: float = 1.0
    fine_rows: int = 0
    opacity_share: float = 1.0
    fusion: str = "product"
    deformed_opacity: bool = True
    modulation: bool = False


def uniform(bound: float, *shape: int) -> nn.Parameter:
    """On the CPU, whose generator draws the same numbers wherever the model goes afterwards."""
    return nn.Parameter(torch.empty(shape, device="cpu").uniform_(-bound, bound))


class DeformationField(nn.Module):
    """One network, or E-D3DGS's coarse and fine one, whose changes add up.

    The layers of two lie one after the other in the same arrays: rows of the first and the heads' layers, columns of
    the output layer. Modulation needs temporal embeddings that are as long as the Gaussians' at least.
    """

    def __init__(self, settings: FrogSettings) -> None:
        super().__init__()
        self.networks, self.modulated = network_count(settings.fusion), settings.modulation
        self.sizes = output_sizes(settings.deformed_sh)
        self.head_width = settings.head_width
        embedding_size, temporal_size = settings.embedding_size, fused_size(settings.fusion, settings.temporal_size)
        units, outputs = self.networks * settings.hidden_width, sum(self.sizes.values())
        bound = (embedding_size + temporal_size) ** -0.5
        self.embedding_weight = uniform(bound, units, embedding_size)
        self.temporal_weight = uniform(bound, units, temporal_size)
        self.bias = uniform(bound, units)
        if self.head_width:
            bound = settings.hidden_width**-0.5
            width = self.networks * self.head_width * len(self.sizes)
            self.head_weight = uniform(bound, width, settings.hidden_width)
            self.head_bias = uniform(bound, width)
        if self.modulated:  # zero: 0.2 dB better than random
            self.modulation_weight = nn.Parameter(torch.zeros(units, embedding_size, device="cpu"))
        # Zero outputs: training starts from the undeformed scene.
        last = self.networks * self.head_width or units
        self.output_weight = nn.Parameter(torch.zeros(outputs, last, device="cpu"))
        self.output_bias = nn.Parameter(torch.zeros(outputs, device="cpu"))

    def hidden(self, temporal: torch.Tensor, embeddings: torch.Tensor) -> torch.Tensor:
        """(N, networks * hidden) the first layer's units."""
        return torch.addmm(self.shared(temporal), embeddings, self.embedding_weights(temporal).T).relu_()

    def shared(self, temporal: torch.Tensor) -> torch.Tensor:
        """(networks * hidden,) the first layer's temporal part and bias at a time, from (networks, T)."""
        weights = self.temporal_weight.reshape(self.networks, -1, self.temporal_weight.shape[1])
        return (weights @ temporal[:, :, None]).flatten() + self.bias

    def embedding_weights(self, temporal: torch.Tensor) -> torch.Tensor:
        """(networks * hidden, E) what embeddings are multiplied with at a time, from (networks, T)."""
        if not self.modulated:
            return self.embedding_weight
        size = self.embedding_weight.shape[1]
        weights = self.modulation_weight.reshape(self.networks, -1, size)
        return self.embedding_weight + (weights * (temporal[:, None, :size] - 1)).flatten(0, 1)

    def by_attribute(self, changes: torch.Tensor) -> dict[str, torch.Tensor]:
        """The network's outputs (N, outputs) by what they change."""
        return dict(zip(self.sizes, changes.split(list(self.sizes.values()), dim=1), strict=True))

    def forward(self, temporal: torch.Tensor, embeddings: torch.Tensor) -> dict[str, torch.Tensor]:
        """Changes by attribute, (N, size) each, of embeddings (N, E) at the fused temporal embedding (networks, T)."""
        sizes = list(self.sizes.values())
        hidden = self.hidden(temporal, embeddings)
        if not self.head_width:
            return self.by_attribute(torch.addmm(self.output_bias, hidden, self.output_weight.T))
        layers = zip(
            *(hidden.chunk(self.networks, dim=1), self.head_weight.chunk(self.networks)),
            *(self.head_bias.chunk(self.networks), self.output_weight.chunk(self.networks, dim=1)),
            strict=True,
        )
        changes = dict(zip(self.sizes, self.output_bias.split(sizes), strict=True))
        for first, head_weight, head_bias, output_weight in layers:
            second = torch.addmm(head_bias, first, head_weight.T).relu_().split(self.head_width, dim=1)
            for name, part, weight in zip(self.sizes, second, output_weight.split(sizes), strict=True):
                changes[name] = changes[name] + part @ weight.T
        return changes


def reduction_factor(d_opacity: torch.Tensor, form: str, sharpness: float, share: float = 1.0) -> torch.Tensor:
    """(N,) factor in (0, 1] on the deformed opacity.

    Args:
        d_opacity: (N,) change of the opacity logit.
        form: "paper" is the formula as printed, sigmoid(k d), which is one half where nothing changes; "unit" is
            min(1, 2 sigmoid(k d)), one where nothing changes; "off" is one.
        sharpness: the paper's k.
        share: 0 to 1, how far the factor is ramped in: 1 + share (factor - 1).
    """
    if form == "off" or share == 0.0:
        return torch.ones_like(d_opacity)
    factor = torch.sigmoid(sharpness * d_opacity)
    if form == "unit":
        factor = (2 * factor).clamp(max=1.0)
    return factor if share == 1.0 else 1 + share * (factor - 1)
