"""Dense seed points: a depth for each pixel of a reduced view, by a plane sweep (Collins 1996).

For each depth hypothesis the neighbours are warped onto the reference with the plane's homography. The depth at which
they agree best is taken. Depth maps are then checked against each other.

Of many cameras some two confirm nearly every surface. Of three, half of an image is hidden from the others, or beyond
their edges, or looks too different from there, and what begins without Gaussians is explained by those of something
else, at a wrong depth. There depth is carried on from what two cameras agree on. Inverse depth is linear on a plane:
local linear fits carry walls and floors on, and diffusion that stops at edges of the image (after Perona and Malik
1990) keeps what is in front apart from what is behind.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float32s, Float64s, Ints
from ..camera import Camera
from ..video import load_opencv
from .views import Cloud, View, cloud_of, joined

_OUTSIDE = -1000.0  # marks pixels that a neighbour does not see
_COLOR_LIMIT, _GRADIENT_LIMIT = 0.15, 0.15  # differences above say "occluded", not "how wrong"


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Planar depth of each pixel of a view.

    Attributes:
        view: the reference.
        depth: (H, W) planar depth in world units, NaN where no neighbour sees the pixel.
        is_unique: (H, W) True where no other depth agrees nearly as well.
        is_textured: (H, W) True where the image has structure to measure depth with.
        step: difference of inverse depth between two hypotheses.
        confirmed: (H, W) True where other views are known to agree.
    """

    view: View
    depth: Float64s
    is_unique: Bools
    is_textured: Bools
    step: float
    confirmed: Bools

    @property
    def points(self) -> Float64s:
        """(H * W, 3) world points, row by row; NaN where there is no depth."""
        camera = self.view.camera
        lines, columns = np.mgrid[: camera.height, : camera.width]
        pixels = np.stack([columns.ravel() + 0.5, lines.ravel() + 0.5, np.ones(columns.size)], axis=1)
        local = pixels @ np.linalg.inv(camera.intrinsics).T * self.depth.reshape(-1, 1)
        return np.asarray((local - camera.world_to_camera[:3, 3]) @ camera.rotation)

    def cloud(self, where: Bools) -> Cloud:
        """The points of some pixels (H, W)."""
        chosen = np.flatnonzero(where)
        colors = self.view.image.reshape(-1, 3)[chosen]
        return cloud_of(self.points[chosen], colors, is_textured=self.is_textured.ravel()[chosen])


def sweep(view: View, others: Sequence[View], near: float, far: float, hypotheses: int = 64) -> DepthMap:
    """The depth map of ``view`` from its neighbours, planes evenly spaced in inverse depth from near to far."""
    inverse_depths = np.linspace(1 / far, 1 / near, hypotheses)
    reference = _channels(view.image)
    sources = [(other.camera, _channels(_match_exposure(other.image, view.image))) for other in others]
    height, width = reference.shape[:2]
    volume = np.empty((hypotheses, height, width), np.float32)
    for plane, inverse_depth in enumerate(inverse_depths):
        costs = [_cost(reference, view.camera, *source, inverse_depth) for source in sources]
        # The better half of the neighbours: a pixel hidden in one view is mostly visible on the other side.
        best = np.sort(costs, axis=0)[: max(1, (len(others) + 1) // 2)]
        volume[plane] = best.mean(axis=0)
    best_index = volume.argmin(axis=0)
    best_cost = np.take_along_axis(volume, best_index[None], axis=0)[0]
    far_away = np.abs(np.arange(hypotheses)[:, None, None] - best_index[None]) > 3
    second_cost = np.where(far_away, volume, np.inf).min(axis=0)
    index = _refine(volume, best_index)
    depth = 1 / np.interp(index, np.arange(hypotheses), inverse_depths)
    structure = load_opencv().boxFilter(reference[..., 3], -1, (7, 7))
    return DepthMap(
        view=view,
        depth=np.where(np.isfinite(best_cost), depth, np.nan),
        is_unique=best_cost < 0.85 * second_cost,
        is_textured=structure > 0.02,
        step=float(inverse_depths[1] - inverse_depths[0]),
        confirmed=np.zeros((height, width), bool),
    )


def agreeing(depth_map: DepthMap, others: Sequence[DepthMap]) -> Ints:
    """(H, W) how many other depth maps agree, within a hypothesis or so."""
    points, votes = depth_map.points, np.zeros(depth_map.depth.size, dtype=int)
    for other in others:
        with np.errstate(invalid="ignore", divide="ignore"):  # of pixels without a depth
            shown, seen = other.view.camera.sample(points, other.depth)
            depths = other.view.camera.project(points)[1]
            votes += seen & (np.abs(1 / shown - 1 / depths) < 1.25 * other.step)
    return votes.reshape(depth_map.depth.shape)


def _channels(image: Float32s) -> Float32s:
    """(H, W, 4) float32: colour, and the length of the brightness gradient (which ignores rotation and exposure)."""
    cv2 = load_opencv()
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    across, along = cv2.Scharr(gray, cv2.CV_32F, 1, 0), cv2.Scharr(gray, cv2.CV_32F, 0, 1)
    return np.dstack([image, np.sqrt(across**2 + along**2) / np.float32(16)])


def _match_exposure(image: Float32s, reference: Float32s) -> Float32s:
    """``image`` with each channel's mean and spread brought to the reference's: cameras differ in exposure."""
    mean, spread = image.mean(axis=(0, 1)), image.std(axis=(0, 1)) + 1e-3
    gain = np.clip((reference.std(axis=(0, 1)) + 1e-3) / spread, 0.6, 1.6)
    # Pulled halfway only: views of different parts of a scene have different means for good reasons.
    gain, shift = (1 + gain) / 2, 0.5 * (reference.mean(axis=(0, 1)) - mean * gain)
    return np.asarray(((image - mean) * gain + mean + shift * 0.5).astype(np.float32))


def _cost(reference: Float32s, camera: Camera, other: Camera, source: Float32s, inverse_depth: float) -> Float32s:
    """(H, W) disagreement of a neighbour with the reference on one plane; infinite where it does not see it."""
    cv2 = load_opencv()
    height, width = reference.shape[:2]
    homography = _homography(camera, other, inverse_depth)
    options = {"flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, "borderValue": (_OUTSIDE,) * 4}
    warped = cv2.warpPerspective(source, homography, (width, height), **options)
    outside = warped[..., 3] < -0.001
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]) @ homography[2]
    if corners.min() <= 0:  # part of the plane lies behind the neighbour
        lines, columns = np.mgrid[:height, :width]
        outside |= homography[2, 0] * columns + homography[2, 1] * lines + homography[2, 2] <= 0
    difference = np.abs(warped - reference)
    color = np.minimum(difference[..., :3].sum(axis=2) / 3, _COLOR_LIMIT)
    cost = color + np.minimum(difference[..., 3], _GRADIENT_LIMIT)
    cost[outside] = _COLOR_LIMIT + _GRADIENT_LIMIT
    # A small window for edges, a large one where a wall has nothing else to hold on to.
    smoothed: Float32s = cv2.boxFilter(cost, -1, (5, 5)) + np.float32(0.5) * cv2.boxFilter(cost, -1, (13, 13))
    smoothed[outside] = np.inf
    return smoothed


def _homography(camera: Camera, other: Camera, inverse_depth: float) -> Float64s:
    """(3, 3) from OpenCV pixels of ``camera`` to those of ``other`` by way of a plane facing the camera."""
    relative = other.world_to_camera @ np.linalg.inv(camera.world_to_camera)
    plane: Float64s = relative[:3, :3].copy()
    plane[:, 2] = plane[:, 2] + inverse_depth * relative[:3, 3]
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV counts pixel centres from 0, the camera from 0.5
    return np.asarray((other.intrinsics - half) @ plane @ np.linalg.inv(camera.intrinsics - half))


def _refine(volume: Float32s, best: Ints) -> Float64s:
    """The cheapest hypothesis with a fraction: the vertex of the parabola through it and its two neighbours."""
    last = len(volume) - 1
    inner = np.clip(best, 1, last - 1)
    below, at, above = (np.take_along_axis(volume, (inner + i)[None], axis=0)[0] for i in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = 0.5 * (below - above) / (below - 2 * at + above)
    shift = np.where(np.isfinite(shift) & (best == inner), np.clip(shift, -0.5, 0.5), 0.0)
    return np.asarray(best + shift)


_WIDTHS = (3, 6, 12, 24, 48, 96)  # pixels: standard deviations of the fits' windows, the first that sees enough
_ENOUGH = 0.08  # of a window is known
_RIDGE = 0.3  # on slopes, in units of the window's variance: few points on a line say nothing across it
_STEPS = 400
_EDGE, _LEAK = 20.0, 1e-3  # how fast a brightness step closes a pixel's border, and what always gets through
_IN_FRONT = 0.97  # of a confirmed depth: what lies nearer would hide it


def points_seen_once(depth_map: DepthMap, others: Sequence[DepthMap]) -> Cloud:
    """The points of the pixels that are not confirmed, without those that would hide what ``others`` confirm."""
    if not depth_map.confirmed.any():
        return joined([])
    filled = replace(depth_map, depth=completed(depth_map))
    cloud = filled.cloud(~filled.confirmed & np.isfinite(filled.depth))
    free = np.ones(len(cloud), bool)
    for other in others:
        surface = np.where(other.confirmed, other.depth, np.inf)
        behind, seen = other.view.camera.sample(cloud.points, surface)
        depths = other.view.camera.project(cloud.points)[1]
        free &= ~(seen & np.isfinite(behind) & (depths < _IN_FRONT * behind))
    return cloud[free]


def completed(depth_map: DepthMap) -> Float64s:
    """(H, W) planar depth: as it is where it is confirmed, which some pixels are, and carried on from there
    elsewhere."""
    cv2, confirmed = load_opencv(), depth_map.confirmed
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
    weight, fitted = known.astype(np.float64), np.full(values.shape, np.nan)
    values = np.where(known, values, 0.0)
    for deviation in _WIDTHS:
        x, y = (columns - width / 2) / deviation, (lines - height / 2) / deviation

        def mean(array: Float64s, deviation: int = deviation) -> Float64s:
            return np.asarray(cv2.GaussianBlur(array, (0, 0), deviation, borderType=cv2.BORDER_CONSTANT))

        share = mean(weight)
        inside = np.isnan(fitted) & (share > _ENOUGH)
        share = np.maximum(share, 1e-12)
        mean_x, mean_y, middle = mean(weight * x) / share, mean(weight * y) / share, mean(values) / share
        xx = mean(weight * x * x) / share - mean_x**2 + _RIDGE
        yy = mean(weight * y * y) / share - mean_y**2 + _RIDGE
        xy = mean(weight * x * y) / share - mean_x * mean_y
        xv, yv = mean(values * x) / share - mean_x * middle, mean(values * y) / share - mean_y * middle
        determinant = xx * yy - xy**2
        across, down = (yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant
        fitted[inside] = (middle + across * (x - mean_x) + down * (y - mean_y))[inside]
    return fitted


def _diffused(values: Float64s, known: Bools, image: Float32s) -> Float64s:
    """(H, W) ``values`` that flow between neighbours but not across edges of the image (H, W, 3), from the known."""
    smooth = load_opencv().GaussianBlur(image, (0, 0), 0.7)
    right, below = (np.exp(-_EDGE * np.abs(np.diff(smooth, axis=axis)).mean(axis=2)) + _LEAK for axis in (1, 0))

    def from_around(values: Float64s) -> Float64s:
        flow = np.zeros(values.shape)
        flow[:, 1:] += right * values[:, :-1]
        flow[:, :-1] += right * values[:, 1:]
        flow[1:] += below * values[:-1]
        flow[:-1] += below * values[1:]
        return flow

    given, total = values, from_around(np.ones(values.shape))
    for _ in range(_STEPS):
        values = np.where(known, given, from_around(values) / total)
    return values
