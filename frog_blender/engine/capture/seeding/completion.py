"""Seed points where one of few cameras sees alone: depth carried on from what two cameras agree on.

Of many cameras some two confirm nearly every surface. Of three, half of an image is hidden from the others, or beyond
their edges, or looks too different from there, and what begins without Gaussians is explained by those of something
else, at a wrong depth. Inverse depth is linear on a plane: local linear fits carry walls and floors on, and diffusion
that stops at edges of the image (after Perona and Malik 1990) keeps what is in front apart from what is behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float32s, Float64s
from ..video import load_opencv
from .plane_sweep import DepthMap, world_points
from .views import sample_view

_WIDTHS = (3, 6, 12, 24, 48, 96)  # pixels: standard deviations of the fits' windows, the first that sees enough
_ENOUGH = 0.08  # of a window is known
_RIDGE = 0.3  # on slopes, in units of the window's variance: few points on a line say nothing across it
_STEPS = 400
_EDGE, _LEAK = 20.0, 1e-3  # how fast a brightness step closes a pixel's border, and what always gets through
_IN_FRONT = 0.97  # of a confirmed depth: what lies nearer would hide it


@dataclass(frozen=True, eq=False)
class ConfirmedDepth:
    """A depth map and the pixels that are believed.

    Attributes:
        depth_map: as the sweep found it.
        confirmed: (H, W) True where other views agree.
    """

    depth_map: DepthMap
    confirmed: Bools


def points_seen_once(view: ConfirmedDepth, others: Sequence[ConfirmedDepth]) -> tuple[Float64s, Float32s, Bools]:
    """World points (N, 3) of the pixels that are not confirmed, their colours (N, 3), and whether (N,) they lie on
    structure; without those that would hide what ``others`` confirm."""
    depth_map = view.depth_map
    if not view.confirmed.any():
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32), np.zeros(0, bool)
    filled = replace(depth_map, depth=completed(depth_map, view.confirmed))
    chosen = np.flatnonzero(~view.confirmed & np.isfinite(filled.depth))
    points = world_points(filled)[chosen]
    free = np.ones(len(points), bool)
    for other in others:
        surface = np.where(other.confirmed, other.depth_map.depth, np.inf)
        behind, seen = sample_view(other.depth_map.view, points, surface)
        depths = other.depth_map.view.camera.project(points)[1]
        free &= ~(seen & np.isfinite(behind) & (depths < _IN_FRONT * behind))
    chosen, points = chosen[free], points[free]
    return points, depth_map.view.image.reshape(-1, 3)[chosen], depth_map.is_textured.ravel()[chosen]


def completed(depth_map: DepthMap, confirmed: Bools) -> Float64s:
    """(H, W) planar depth: as it is where it is ``confirmed`` (H, W), which some pixels are, and carried on from there
    elsewhere."""
    cv2 = load_opencv()
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(confirmed, 1 / depth_map.depth, 0.0)
    known = confirmed & (cv2.medianBlur(confirmed.astype(np.uint8), 3) > 0)  # single pixels are mistakes
    if not known.any():
        known = confirmed
    values = _fitted(inverse, known)
    low, high = np.quantile(inverse[known], [0.02, 0.98])
    values = np.where(np.isfinite(values), values, np.median(inverse[known])).clip(0.8 * low, high)
    values = _diffused(np.where(known, inverse, values), known, depth_map.view.image)
    return np.where(confirmed, depth_map.depth, 1 / values)


def _fitted(values: Float64s, known: Bools) -> Float64s:
    """(H, W) at each pixel the linear function that fits the known ``values`` around it; NaN far from any."""
    cv2 = load_opencv()
    height, width = values.shape
    lines, columns = np.mgrid[:height, :width].astype(np.float64)
    weight, found = known.astype(np.float64), np.full(values.shape, np.nan)
    values = np.where(known, values, 0.0)
    for deviation in _WIDTHS:
        x, y = (columns - width / 2) / deviation, (lines - height / 2) / deviation

        def mean(array: Float64s, deviation: int = deviation) -> Float64s:
            blurred: Float64s = cv2.GaussianBlur(array, (0, 0), deviation, borderType=cv2.BORDER_CONSTANT)
            return blurred

        share = mean(weight)
        inside = np.isnan(found) & (share > _ENOUGH)
        share = np.maximum(share, 1e-12)
        mean_x, mean_y, middle = mean(weight * x) / share, mean(weight * y) / share, mean(values) / share
        xx = mean(weight * x * x) / share - mean_x**2 + _RIDGE
        yy = mean(weight * y * y) / share - mean_y**2 + _RIDGE
        xy = mean(weight * x * y) / share - mean_x * mean_y
        xv, yv = mean(values * x) / share - mean_x * middle, mean(values * y) / share - mean_y * middle
        determinant = xx * yy - xy**2
        across, down = (yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant
        found[inside] = (middle + across * (x - mean_x) + down * (y - mean_y))[inside]
    return found


def _diffused(values: Float64s, known: Bools, image: Float32s) -> Float64s:
    """(H, W) ``values`` that flow between neighbours but not across edges of the image (H, W, 3), from the known."""
    cv2 = load_opencv()
    smooth = cv2.GaussianBlur(image, (0, 0), 0.7)
    right, below = (np.exp(-_EDGE * np.abs(np.diff(smooth, axis=axis)).mean(axis=2)) + _LEAK for axis in (1, 0))
    total = np.zeros(values.shape)
    total[:, 1:] += right
    total[:, :-1] += right
    total[1:] += below
    total[:-1] += below
    given = values
    for _ in range(_STEPS):
        flow = np.zeros(values.shape)
        flow[:, 1:] += right * values[:, :-1]
        flow[:, :-1] += right * values[:, 1:]
        flow[1:] += below * values[:-1]
        flow[:-1] += below * values[1:]
        values = np.where(known, given, flow / total)
    return values
