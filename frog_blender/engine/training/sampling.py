"""Canonical field sampling (FRoG, section of that name): new anchors where a training view shows high error.

Pixels of high error are sent along their rays to the median depth, and the points are put into the canonical field as
they are: low-cost anchors, whose small deformation is learned from the embedding of the Gaussian that moves least.
"""

from __future__ import annotations

import torch
from torch.nn import functional

from ..capture.camera import Camera
from ..model.canonical import new_gaussians
from ..rasterizer import Image
from .neighbours import spacings

_PATCH = 7  # pixels: single bright pixels are noise
_BRIGHTNESS_FLOOR = 0.05  # of the display range: below it, error counts as it is


def error_map(rgb: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """(H, W) mean absolute error over a patch, relative to the patch's brightness, so that dim places count too."""

    def smooth(picture: torch.Tensor) -> torch.Tensor:
        return functional.avg_pool2d(picture[None, None], _PATCH, 1, _PATCH // 2, count_include_pad=False)[0, 0]

    return smooth((rgb - truth).abs().mean(2)) / (smooth(truth.mean(2)) + _BRIGHTNESS_FLOOR)


def choose_pixels(score: torch.Tensor, depth: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """(<= count,) flat indices of pixels drawn in proportion to score among the worst tenth that have a depth."""
    usable = torch.isfinite(depth) & torch.isfinite(score)
    score = torch.where(usable, score, 0).flatten()
    candidates = score.topk(max(1, score.numel() // 10)).indices
    candidates = candidates[score[candidates] > 0]
    if len(candidates) == 0:
        return candidates
    weights = score[candidates].cpu()  # where the generator is
    drawn = torch.multinomial(weights, min(count, len(candidates)), generator=generator)
    return candidates[drawn.to(candidates.device)]


@torch.no_grad()
def anchors(
    image: Image,
    truth: torch.Tensor,
    camera: Camera,
    count: int,
    existing: torch.Tensor,
    sh_count: int,
    embedding: torch.Tensor,
    generator: torch.Generator,
) -> dict[str, torch.Tensor]:
    """New Gaussians by attribute (see new_gaussians), at most ``count``.

    Args:
        image: drawn with median depth.
        truth: (H, W, 3) the training picture.
        existing: (N, 3) canonical means, for the size of the new ones.
        embedding: (E,) of the Gaussian that deforms least at this moment.
    """
    assert image.median_depth is not None
    # Coverage is a second cue: what nothing covers shows no error against a dark truth.
    score = error_map(image.rgb, truth) + (1 - image.alpha)
    chosen = choose_pixels(score, image.median_depth, count, generator)
    width = image.median_depth.shape[1]
    pixels = torch.stack([chosen % width, torch.div(chosen, width, rounding_mode="floor")], dim=1) + 0.5
    distances = image.median_depth.flatten()[chosen]
    places = camera.unproject(pixels.double().cpu().numpy(), distances.double().cpu().numpy())
    points = torch.from_numpy(places).float().to(existing.device)
    colors = truth.reshape(-1, 3)[chosen]
    sizes = spacings(points, existing) if len(points) else points.new_empty(0)
    new = new_gaussians(points, colors, sizes, sh_count, len(embedding))
    new["embeddings"] = embedding.expand(len(points), -1).clone()
    return new
