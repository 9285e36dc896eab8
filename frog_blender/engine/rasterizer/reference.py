"""The rasterizer in plain torch: every Gaussian against every pixel, in any precision. The oracle of the fast ones.

Memory grows with pixels times Gaussians; pixels are taken in strips, so that small scenes fit anywhere.
"""

import math
from dataclasses import dataclass

import torch

from ..capture.camera import Camera
from ..gaussians import TorchGaussians, rotation_terms
from ..native.options import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN, RasterizeOptions
from ..spherical_harmonics import SH_DC, sh_terms
from . import Image
from .cpu import distances_from
from .differentiable import picked
from .torch_types import kind_of

_STRIP_ELEMENTS = 8_000_000  # pixels times Gaussians held at once


def sh_basis(count: int, directions: torch.Tensor) -> torch.Tensor:
    """(N, count) real spherical harmonics at unit directions (N, 3), in the order and signs of 3DGS."""
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, SH_DC), *sh_terms(count, x, y, z)]
    return torch.stack(terms, dim=-1)


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:
    """(N, 3, 3) rotations of quaternions (N, 4) w, x, y, z of any length but zero."""
    unit = torch.nn.functional.normalize(quaternions, dim=-1)
    return torch.stack(rotation_terms(*unit.unbind(-1)), dim=-1).reshape(-1, 3, 3)


@dataclass
class _Splats:
    """Visible Gaussians on the screen, nearest first."""

    index: torch.Tensor  # (M,) into the input
    pixels: torch.Tensor  # (M, 2)
    conics: torch.Tensor  # (M, 3) inverse covariance a, b, c
    opacities: torch.Tensor  # (M,)
    colors: torch.Tensor  # (M, 3)
    depths: torch.Tensor  # (M,)
    radii: torch.Tensor  # (M,)


def _clamped_tangents(local: torch.Tensor, camera: Camera) -> torch.Tensor:
    """x / z and y / z (N, 2), clamped to the image and 15 % around it, where the projection is linearised."""
    k = camera.intrinsics
    tangents = []
    for axis, (focal, center, size) in enumerate([(k[0, 0], k[0, 2], camera.width), (k[1, 1], k[1, 2], camera.height)]):
        margin = 0.15 * size
        low, high = (-margin - center) / focal, (size + margin - center) / focal
        tangents.append((local[:, axis] / local[:, 2]).clamp(low, high))
    return torch.stack(tangents, dim=-1)


def _usable(g: TorchGaussians, local: torch.Tensor) -> torch.Tensor:
    """(N,) True where the numbers are finite and in range; the others are dropped."""
    square = g.quaternions.square().sum(-1)
    usable = (square > 1e-24) & (square < 1e24) & (g.opacities.abs() < 1e30)
    usable &= (local.abs() < 1e30).all(-1) & (g.scales.abs() < 1e12).all(-1)
    return usable


def _project(
    g: TorchGaussians, screen: torch.Tensor, camera: Camera, options: RasterizeOptions, pose: torch.Tensor | None
) -> _Splats:
    like = kind_of(g.means)
    view = torch.as_tensor(camera.world_to_camera, **like) if pose is None else pose.to(**like)
    left, top, width, height = options.region_of(camera)
    k = camera.intrinsics
    with torch.no_grad():
        local = g.means @ view[:3, :3].T + view[:3, 3]
        usable = _usable(g, local)
        usable &= (local[:, 2] >= options.near_plane) & (g.opacities > ALPHA_MIN)
        kept = (usable & torch.isfinite(g.sh).flatten(1).all(-1)).nonzero().squeeze(-1)

    means, opacities = g.means[kept], g.opacities[kept].clamp(max=1.0)
    local = means @ view[:3, :3].T + view[:3, 3]
    z = local[:, 2]
    tangents = _clamped_tangents(local, camera)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([k[0, 0] / z, zero, -k[0, 0] / z * tangents[:, 0]], -1),
            torch.stack([zero, k[1, 1] / z, -k[1, 1] / z * tangents[:, 1]], -1),
        ],
        dim=1,
    )
    axes = jacobian @ view[:3, :3] @ rotation_matrices(g.quaternions[kept]) * g.scales[kept][:, None, :]
    thin = axes @ axes.transpose(1, 2)
    covariance = thin + torch.as_tensor(g.low_pass, **like).expand(len(g))[kept, None, None] * torch.eye(2, **like)
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = xx * yy - xy * xy
    pixels = torch.stack([k[0, 0] * local[:, 0] / z + k[0, 2] - left, k[1, 1] * local[:, 1] / z + k[1, 2] - top], -1)
    directions = torch.nn.functional.normalize(means + view[:3, 3] @ view[:3, :3], dim=-1)
    sh = g.sh[kept]
    colors = (torch.einsum("nk,nkc->nc", sh_basis(sh.shape[1], directions), sh) + 0.5).clamp(min=0)
    reach = torch.log(opacities.detach() / ALPHA_MIN).clamp(min=0)
    extents = (2 * reach[:, None] * torch.stack([xx, yy], -1).detach()).sqrt()
    size = torch.tensor([width, height], **like)
    seen = ((pixels + extents >= 0.5) & (pixels - extents <= size - 0.5)).all(-1) & (opacities > ALPHA_MIN)
    order = torch.sort(z.detach(), stable=True).indices
    order = order[seen[order]]
    conics = torch.stack([yy, -xy, xx], -1) / determinant[:, None]
    splats = (kept, pixels + screen[kept], conics, opacities, colors, z, extents.amax(-1))
    return _Splats(*(part[order] for part in splats))


def _blend(
    splats: _Splats, points: torch.Tensor, limits: torch.Tensor, background: torch.Tensor
) -> tuple[torch.Tensor, ...]:
    """Blends all M splats at pixel centres (P, 2), front to back, as far as each pixel's depth limit (P,).

    Returns:
        (P, 3) colours and (P,) alphas; (P,) positions of the median in the splats, -1 where there is none; (P,) mean
        depths; (M,) each splat's largest weight.
    """
    dx = points[:, None, 0] - splats.pixels[None, :, 0]  # (P, M)
    dy = points[:, None, 1] - splats.pixels[None, :, 1]
    a, b, c = splats.conics.unbind(-1)
    power = -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
    alpha = splats.opacities * torch.exp(power)
    seen = (alpha >= ALPHA_MIN) & (splats.depths <= limits[:, None])
    alpha = torch.where(seen, alpha.clamp(max=ALPHA_MAX), torch.zeros_like(alpha))
    # A Gaussian that would take transmittance below the limit finishes the pixel: it and all behind it are left out.
    after = torch.cumprod(1 - alpha, dim=1)
    alpha = torch.where(after.detach() >= TRANSMITTANCE_MIN, alpha, torch.zeros_like(alpha))
    after = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    weights = alpha * before
    remaining = torch.prod(1 - alpha, dim=1)
    crossing = (before > 0.5) & (after <= 0.5)
    median = torch.full_like(remaining, -1, dtype=torch.long)
    if len(splats.index):
        median = torch.where(crossing.any(1), crossing.int().argmax(1), -1)
    covered = (1 - remaining).detach()
    mean_depth = torch.where(covered > 0, (weights @ splats.depths).detach() / covered, math.nan)
    rgb = weights @ splats.colors + remaining[:, None] * background
    return rgb, 1 - remaining, median, mean_depth, weights.detach().amax(0)


def rasterize(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    pose: torch.Tensor | None = None,
) -> Image:
    """As ``rasterizer.rasterize``, on any device and in any floating-point type."""
    like = kind_of(gaussians.means)
    if pose is not None:
        camera = camera.with_pose(pose.detach().cpu().numpy())
    count = len(gaussians)
    _, _, width, height = options.region_of(camera)
    screen = torch.zeros((count, 2), requires_grad=True, **like)
    splats = _project(gaussians, screen, camera, options, pose)
    color = torch.tensor(background, **like)
    y, x = torch.meshgrid(torch.arange(height, **like) + 0.5, torch.arange(width, **like) + 0.5, indexing="ij")
    points = torch.stack([x.flatten(), y.flatten()], -1)
    size = (height, width)
    piece = max(1, _STRIP_ELEMENTS // max(1, len(splats.index)))
    limit = math.inf if options.depth_limit is None else torch.from_numpy(options.depth_limit).flatten()
    limits = torch.as_tensor(limit, **like).expand(len(points))
    parts = zip(points.split(piece), limits.split(piece), strict=True)
    *strips, heaviest = zip(*(_blend(splats, *part, color) for part in parts), strict=True)
    rgb, alpha, median, mean_depth = map(torch.cat, strips)
    radii, weights = torch.zeros(count, **like), torch.zeros(count, **like)
    radii[splats.index] = splats.radii
    weights[splats.index] = torch.stack(heaviest).amax(0)
    image = Image(rgb.reshape(*size, 3), alpha.reshape(size), radii, screen)
    if options.depth:
        distances = distances_from(camera, gaussians.means.detach()[splats.index])
        image.median_depth = picked(median.reshape(size), distances)
        image.mean_depth = mean_depth.reshape(size)
    if options.weights:
        image.max_weights = weights
    return image
