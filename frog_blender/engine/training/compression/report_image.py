"""An image of where a scene's capacity went: what rests, what moves, and what was left out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from ...capture.time import frame_to_time
from ...model.canonical import SH_DC
from ...playback.render import to_uint8
from ...rasterizer import GaussianArrays, rasterize
from ..optimize.gaussian_order import gaussians_at

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer

# Apart for the colour-blind as well.
AT_REST, MOVING, REMOVED = (0.35, 0.60, 0.85), (1.00, 0.60, 0.05), (0.85, 0.10, 0.35)


@torch.no_grad()
def draw_report_image(trainer: Trainer, shot_index: int) -> np.ndarray:
    """(H, W, 3) uint8 what a shot shows, in blue what rests, in orange what moves, with red dots where Gaussians were.

    Brightness is the scene's own, so that things can be told.
    """
    capture, canonical = trainer.capture, trainer.model.canonical
    shot = capture.shots[shot_index]
    gaussians = gaussians_at(trainer, frame_to_time(shot.frame, capture.frame_count))
    brightness = (gaussians.sh[:, 0].mean(1) * SH_DC + 0.5).clamp(0, 1)
    tints = torch.tensor(AT_REST, device=brightness.device).repeat(trainer.count, 1)
    tints[: canonical.num_dynamic] = torch.tensor(MOVING, device=brightness.device)
    colors = tints * (0.25 + 0.75 * brightness[:, None])
    everything = _with_removed(trainer, gaussians, colors)
    image = rasterize(everything, capture.cameras[shot.camera], (0.0, 0.0, 0.0))
    return to_uint8(image.rgb.cpu().numpy())


def _with_removed(trainer: Trainer, gaussians: GaussianArrays, colors: torch.Tensor) -> GaussianArrays:
    """Those that are there in ``colors``, and small balls for those that are not."""
    removed = torch.from_numpy(trainer.compression.removed if trainer.compression else np.empty((0, 3), np.float32))
    removed = removed.to(gaussians.means)
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
