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

from __future__ import annotations

import torch
from torch import nn

from ..field.network import output_sizes


def _uniform(bound: float, *shape: int) -> nn.Parameter:
    """On the CPU, whose generator draws the same numbers wherever the model goes afterwards."""
    return nn.Parameter(torch.empty(shape, device="cpu").uniform_(-bound, bound))


class DeformationField(nn.Module):
    """Args:
    embedding_size, temporal_size: lengths of e and of the temporal embedding that a network is given.
    hidden_width: first layer.
    head_width: hidden layer of each head as in the paper (five of 128); 0 shares the first layer among all heads,
        which gave the same PSNR at a third of the time.
    sh_count: SH coefficients that deform (0 to K).
    networks: 2 for E-D3DGS's coarse and fine network, whose changes add up. Their layers lie one after the other in
        the same arrays: rows of the first and the heads' layers, columns of the output layer.
    modulated: see the module; needs temporal_size >= embedding_size.
    """

    def __init__(
        self,
        embedding_size: int,
        temporal_size: int,
        hidden_width: int,
        head_width: int,
        sh_count: int,
        networks: int = 1,
        *,
        modulated: bool = False,
    ) -> None:
        super().__init__()
        self.networks, self.modulated = networks, modulated
        self.sizes = output_sizes(sh_count)
        self.head_width = head_width
        bound = (embedding_size + temporal_size) ** -0.5
        self.embedding_weight = _uniform(bound, networks * hidden_width, embedding_size)
        self.temporal_weight = _uniform(bound, networks * hidden_width, temporal_size)
        self.bias = _uniform(bound, networks * hidden_width)
        outputs = sum(self.sizes.values())
        if head_width:
            bound = hidden_width**-0.5
            width = networks * head_width * len(self.sizes)
            self.head_weight = _uniform(bound, width, hidden_width)
            self.head_bias = _uniform(bound, width)
        if modulated:  # zero: 0.2 dB better than random
            self.modulation_weight = nn.Parameter(torch.zeros(networks * hidden_width, embedding_size, device="cpu"))
        # Zero outputs: training starts from the undeformed scene.
        self.output_weight = nn.Parameter(torch.zeros(outputs, networks * (head_width or hidden_width), device="cpu"))
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
