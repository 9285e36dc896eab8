"""Where the surface lies that a camera sees of Gaussians."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..gaussians import NumpyGaussians
from ..playback.render import draw

_REACH = 4.0  # standard deviations; further from its centre a Gaussian is not drawn


def surface_depth(gaussians: NumpyGaussians, camera: Camera) -> Array:
    """(H, W) float32 planar depth of the surface along each pixel's ray, world units; NaN where the ray goes through.

    The surface is where the Gaussian that takes transmittance through one half is densest along the ray. Its centre,
    which ``Drawing.median_z`` gives, makes steps of a floor that few large Gaussians cover.
    """
    index = draw(gaussians, camera).median_index
    depth = np.full(index.shape, np.nan, np.float32)
    rows, columns = np.nonzero(index >= 0)
    if not rows.size:
        return depth
    which = index[rows, columns]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    rays = (pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation).astype(np.float32)  # of planar depth 1
    centers = gaussians.means[which] - camera.center.astype(np.float32)
    axes, scales = _axes(gaussians.quaternions[which]), np.maximum(gaussians.scales[which], 1e-12)
    local_rays = np.einsum("nij,ni->nj", axes, rays) / scales
    local_centers = np.einsum("nij,ni->nj", axes, centers) / scales
    with np.errstate(over="ignore", invalid="ignore"):
        densest = (local_rays * local_centers).sum(1) / (local_rays**2).sum(1)
        away = np.linalg.norm(rays * densest[:, None] - centers, axis=1)
    planar = centers @ camera.forward.astype(np.float32)
    on_it = np.isfinite(densest) & (densest > 0) & (away <= _REACH * scales.max(1))
    depth[rows, columns] = np.where(on_it, densest, planar)
    return depth


def _axes(quaternions: Array) -> Array:
    """(N, 3, 3) rotations of (N, 4) quaternions w, x, y, z of any length: a Gaussian's axes are the columns."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
