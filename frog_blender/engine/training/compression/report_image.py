"""An image of where a scene's capacity went: what is static, what is dynamic, and what was pruned."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ...gaussians import TorchGaussians
from ...playback.render import to_uint8
from ...rasterizer import GaussianArrays, rasterize
from ...spherical_harmonics import SH_DC
from .context import CompressionContext

# Apart for the colour-blind as well.
STATIC, DYNAMIC, REMOVED = (0.35, 0.60, 0.85), (1.00, 0.60, 0.05), (0.85, 0.10, 0.35)


@torch.no_grad()
def draw_report_image(context: CompressionContext, shot_index: int) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 what a shot shows: blue is static, orange dynamic, red dots are pruned Gaussians.

    Brightness is the scene's own, so that things can be told.
    """
    capture = context.training.capture
    shot = capture.shots[shot_index]
    gaussians = context.gaussians_at(capture.time_of(shot))
    brightness = (gaussians.sh[:, 0].mean(1) * SH_DC + 0.5).clamp(0, 1)
    tints = torch.tensor(STATIC, device=brightness.device).repeat(len(brightness), 1)
    tints[: context.num_dynamic] = torch.tensor(DYNAMIC, device=brightness.device)
    colors = tints * (0.25 + 0.75 * brightness[:, None])
    everything = _with_removed(context.record.removed, gaussians, colors)
    image = rasterize(everything, capture.cameras[shot.camera], (0.0, 0.0, 0.0))
    return to_uint8(image.rgb.cpu().numpy())


def _with_removed(places: NDArray[np.float32], gaussians: TorchGaussians, colors: torch.Tensor) -> TorchGaussians:
    """The Gaussians in ``colors`` (N, 3), and small balls at ``places`` (n, 3)."""
    removed = torch.from_numpy(places).to(gaussians.means)
    count, size = len(removed), 0.3 * float(gaussians.scales.median())
    upright = torch.tensor([1.0, 0, 0, 0], device=removed.device).repeat(count, 1)
    colors = torch.cat([colors, torch.tensor(REMOVED, device=removed.device).repeat(count, 1)])
    return GaussianArrays(
        torch.cat([gaussians.means, removed]),
        torch.cat([gaussians.quaternions, upright]),
        torch.cat([gaussians.scales, torch.full((count, 3), size, device=removed.device)]),
        torch.cat([gaussians.opacities, torch.full((count,), 0.8, device=removed.device)]),
        ((colors - 0.5) / SH_DC)[:, None].contiguous(),
    )
