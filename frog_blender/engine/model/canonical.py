"""The canonical field: Gaussians before deformation, as the parameters that are learned."""

import torch
from torch import nn

from ..gaussians import LOW_PASS, TorchGaussians
from ..rasterizer import GaussianArrays
from ..spherical_harmonics import SH_DC

ATTRIBUTES = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "embeddings")


class CanonicalField(nn.Module):
    """N Gaussians: the first M are dynamic, the others are static.

    Density control can treat all attributes alike: their first dimension is N, of the embeddings M.

    Attributes:
        means: (N, 3) world units.
        log_scales: (N, 3) logarithms of standard deviations.
        quaternions: (N, 4) w, x, y, z, normalised when drawn.
        opacity_logits: (N,).
        sh: (N, K, 3).
        embeddings: (M, E) what the deformation field knows of each dynamic Gaussian; E = 0 for methods without.
        low_pass: see GaussianArrays.
    """

    low_pass: float = LOW_PASS
    means: torch.Tensor
    log_scales: torch.Tensor
    quaternions: torch.Tensor
    opacity_logits: torch.Tensor
    sh: torch.Tensor
    embeddings: torch.Tensor

    def __init__(self, values: dict[str, torch.Tensor]) -> None:
        super().__init__()
        for name in ATTRIBUTES:
            self.register_parameter(name, nn.Parameter(values[name]))

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def num_dynamic(self) -> int:
        """Gaussians that are deformed, M."""
        return self.embeddings.shape[0]

    def gaussians(self, sh_count: int | None = None) -> TorchGaussians:
        """The undeformed Gaussians, activated, with the first ``sh_count`` coefficients (None: all)."""
        sh = self.sh[:, :sh_count]
        scales, opacities = self.log_scales.exp(), self.opacity_logits.sigmoid()
        return GaussianArrays(self.means, self.quaternions, scales, opacities, sh, low_pass=self.low_pass)


def new_gaussians(
    points: torch.Tensor, colors: torch.Tensor, spacings: torch.Tensor, sh_count: int, embedding_size: int
) -> dict[str, torch.Tensor]:
    """Fresh isotropic Gaussians (the paper's values: identity rotation, opacity 0.1, embedding zero).

    Args:
        points: (N, 3) world units.
        colors: (N, 3) display-referred, in [0, 1].
        spacings: (N,) distance to the neighbours, which becomes the standard deviation.
        sh_count: coefficients a channel, K.
        embedding_size: E.
    """
    count, device = len(points), points.device
    sh = torch.zeros(count, sh_count, 3, device=device)
    # Colours end at 0, and what ends there learns nothing: half a grey level is as black, and learns.
    sh[:, 0] = (colors.clamp(min=1 / 510) - 0.5) / SH_DC
    quaternions = torch.zeros(count, 4, device=device)
    quaternions[:, 0] = 1
    return {
        "means": points.clone(),
        "log_scales": spacings.clamp(min=1e-7).log()[:, None].repeat(1, 3),
        "quaternions": quaternions,
        "opacity_logits": torch.full((count,), 0.1, device=device).logit(),
        "sh": sh,
        "embeddings": torch.zeros(count, embedding_size, device=device),
    }
