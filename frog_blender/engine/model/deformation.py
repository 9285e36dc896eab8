"""The deformation field: one small network from (temporal embedding, Gaussian embedding) to attribute changes.

Its first layer separates, W [t; e] + b = (W_t t + b) + W_e e, so the N x (T + E) concatenation is never built:
``W_t t + b`` is one vector a moment, and ``W_e e`` does not depend on time at all (playback caches it).
"""

from __future__ import annotations

import torch
from torch import nn

HEADS = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1, "sh": 0}
"""What each head changes and how many numbers it puts out; ``sh`` has three for each coefficient it deforms."""


def _uniform(bound: float, *shape: int) -> nn.Parameter:
    """On the CPU, whose generator draws the same numbers wherever the model goes afterwards."""
    return nn.Parameter(torch.empty(shape, device="cpu").uniform_(-bound, bound))


class DeformationField(nn.Module):
    """Args:
    embedding_size, temporal_size: lengths of e and t.
    hidden_width: first layer.
    head_width: hidden layer of each head as in the paper (five of 128); 0 shares the first layer among all heads,
        which gave the same PSNR at a third of the time.
    sh_count: SH coefficients that deform (0 to K).
    """

    def __init__(
        self, embedding_size: int, temporal_size: int, hidden_width: int, head_width: int, sh_count: int
    ) -> None:
        super().__init__()
        self.sizes = {name: size or 3 * sh_count for name, size in HEADS.items()}
        self.sizes = {name: size for name, size in self.sizes.items() if size}
        self.head_width = head_width
        bound = (embedding_size + temporal_size) ** -0.5
        self.embedding_weight = _uniform(bound, hidden_width, embedding_size)
        self.temporal_weight = _uniform(bound, hidden_width, temporal_size)
        self.bias = _uniform(bound, hidden_width)
        outputs = sum(self.sizes.values())
        if head_width:
            bound = hidden_width**-0.5
            width = head_width * len(self.sizes)
            self.head_weight = _uniform(bound, width, hidden_width)
            self.head_bias = _uniform(bound, width)
        # Zero outputs: training starts from the undeformed scene.
        self.output_weight = nn.Parameter(torch.zeros(outputs, head_width or hidden_width, device="cpu"))
        self.output_bias = nn.Parameter(torch.zeros(outputs, device="cpu"))

    def forward(self, temporal: torch.Tensor, embeddings: torch.Tensor) -> dict[str, torch.Tensor]:
        """Changes by attribute, (N, size) each, of embeddings (N, E) at the fused temporal embedding (T,)."""
        shared = self.temporal_weight @ temporal + self.bias
        hidden = torch.addmm(shared, embeddings, self.embedding_weight.T).relu_()
        if not self.head_width:
            output = torch.addmm(self.output_bias, hidden, self.output_weight.T)
            return dict(zip(self.sizes, output.split(list(self.sizes.values()), dim=1), strict=True))
        hidden = torch.addmm(self.head_bias, hidden, self.head_weight.T).relu_()
        weights = self.output_weight.split(list(self.sizes.values()))
        biases = self.output_bias.split(list(self.sizes.values()))
        slices = hidden.split(self.head_width, dim=1)
        return {
            name: torch.addmm(bias, part, weight.T)
            for name, part, weight, bias in zip(self.sizes, slices, weights, biases, strict=True)
        }
