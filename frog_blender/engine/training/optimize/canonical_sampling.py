"""Canonical field sampling (FRoG, section of that name): new anchors where a training view shows high error.

Pixels of high error are sent along their rays to the median depth, and the points are put into the canonical field as
they are: low-cost anchors, which begin with the embedding of the Gaussian that is deformed least.
The paper's two variants are here too: mean depth, and points moved back by an inverse deformation.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch.nn import functional

from ...capture.camera import Camera
from ...model.canonical import ATTRIBUTES, new_gaussians
from ...model.frog import total_deformation
from ...model.interface import RenderResult
from ...rasterizer import Image
from .densification import DensityStrategy
from .gaussian_state import GaussianState, mask_excluding
from .mattes import Truth
from .neighbours import nearest, spacings

_WHILE_FEW = 0.01  # anchors of half the limit of Gaussians, a round
_PATCH = 7  # pixels: single bright pixels are noise
_BRIGHTNESS_FLOOR = 0.05  # of the display range: below it, error counts as it is


def error_map(rgb: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """(H, W) mean absolute error over a patch, relative to the patch's brightness, so that dim places count too."""

    def smooth(image: torch.Tensor) -> torch.Tensor:
        return functional.avg_pool2d(image[None, None], _PATCH, 1, _PATCH // 2, count_include_pad=False)[0, 0]

    return smooth((rgb - truth).abs().mean(2)) / (smooth(truth.mean(2)) + _BRIGHTNESS_FLOOR)


def pixel_errors(image: Image, truth: torch.Tensor, kind: str) -> torch.Tensor:
    """(H, W) how wrong each pixel of a drawing is; see ``Recipe.sampling_error``."""
    if kind == "l1":
        return (image.rgb - truth).abs().mean(2)
    # Coverage is a second cue: what nothing covers shows no error against a dark truth.
    return error_map(image.rgb, truth) + (1 - image.alpha)


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


def distances_along_rays(image: Image, camera: Camera, kind: str) -> torch.Tensor:
    """(H, W) Euclidean distance to the surface: the median depth as it is, or the mean planar depth made Euclidean."""
    if kind == "median":
        assert image.median_depth is not None
        return image.median_depth
    assert image.mean_depth is not None
    height, width = image.mean_depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    rays = camera.ray_directions(np.stack([x.ravel(), y.ravel()], axis=1))
    planar = (rays @ camera.forward).reshape(height, width)
    return image.mean_depth / torch.from_numpy(planar).to(image.mean_depth)


def worst_points(
    errors: torch.Tensor,
    distances: torch.Tensor,
    truth: torch.Tensor,
    camera: Camera,
    count: int,
    generator: torch.Generator,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Points (M, 3) in the deformed scene, and colours (M, 3), of at most ``count`` pixels of high error.

    Args:
        errors: (H, W) of a drawing.
        distances: (H, W) along its rays to the surface; not finite for pixels that may not be chosen.
        truth: (H, W, 3) the training image.
    """
    chosen = choose_pixels(errors, distances, count, generator)
    width = distances.shape[1]
    pixels = torch.stack([chosen % width, torch.div(chosen, width, rounding_mode="floor")], dim=1) + 0.5
    points = camera.unproject(pixels.double().cpu().numpy(), distances.flatten()[chosen].double().cpu().numpy())
    return torch.from_numpy(points).float().to(truth.device), truth.reshape(-1, 3)[chosen]


def undeformed(
    points: torch.Tensor, deformed: torch.Tensor, motion: torch.Tensor, embeddings: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Canonical positions of points (M, 3) of the deformed scene that move as the nearest Gaussian does, and that
    Gaussian's embeddings (M, E): the paper's inverse deformation, which it shows to be unstable.

    Args:
        deformed, motion: (M, 3) means at the time, and what was added to the canonical ones, of the dynamic Gaussians.
        embeddings: (M, E).
    """
    closest = nearest(points, deformed.detach(), 1, skip_self=False)[1][:, 0]
    return points - motion.detach()[closest], embeddings.detach()[closest]


def new_anchors(
    points: torch.Tensor, colors: torch.Tensor, embeddings: torch.Tensor, existing: torch.Tensor, sh_count: int
) -> dict[str, torch.Tensor]:
    """New Gaussians by attribute (see new_gaussians) at canonical ``points`` (M, 3), with ``embeddings`` (M, E).

    Args:
        existing: (N, 3) canonical means, for the size of the new ones.
    """
    new = new_gaussians(points, colors, spacings(points, existing), sh_count, embeddings.shape[1])
    new["embeddings"] = embeddings.detach().clone()
    return new


@torch.no_grad()
def inject_anchors(
    gaussians: GaussianState,
    density: DensityStrategy,
    limit: int,
    draw: Callable[[], tuple[Truth, RenderResult, Camera]],
    generator: torch.Generator,
) -> None:
    """One round: new anchors where a drawing is wrong, behind the other dynamic Gaussians. At the limit they replace
    those that are needed least.

    Args:
        limit: Gaussians at most.
        draw: a training image, its drawing with depth, and the camera.
    """
    recipe, canonical = density.recipe, gaussians.canonical
    num_new = recipe.num_new(gaussians.count, recipe.sampling_share, _WHILE_FEW)
    room = max(limit - gaussians.count, 0)
    replaced = density.least_needed(num_new - room)
    num_new = min(num_new, room + len(replaced))
    if not num_new:
        return
    target, drawn, camera = draw()
    changes = drawn.changes
    if not changes:
        return
    truth, subject = target.colors, target.whole
    distances = distances_along_rays(drawn.image, camera, recipe.sampling_depth)
    if subject is not None:
        truth = torch.where(subject[..., None], truth, drawn.image.rgb)  # patches of the error reach beyond
        distances = torch.where(subject, distances, torch.inf)
    errors = pixel_errors(drawn.image, truth, recipe.sampling_error)
    points, colors = worst_points(errors, distances, truth, camera, num_new, generator)
    if recipe.sampling == "inverse":
        deformed = drawn.gaussians.means[: gaussians.num_dynamic]
        points, embeddings = undeformed(points, deformed, changes["means"], canonical.embeddings)
    else:
        calmest = canonical.embeddings.detach()[int(total_deformation(changes).argmin())].clone()
        calmest[recipe.embedding_size :] = 0  # without the time window that it may have
        embeddings = calmest.expand(len(points), -1)
    new = new_anchors(points, colors, embeddings, canonical.means.detach(), canonical.sh.shape[1])
    replaced = replaced[: max(len(points) - room, 0)]  # fewer pixels than asked for may have a depth
    kept = mask_excluding(replaced, gaussians.count).nonzero().squeeze(1)
    gaussians.replace(kept, {name: new[name] for name in ATTRIBUTES})
