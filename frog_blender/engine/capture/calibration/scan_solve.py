"""Standing cameras in the world of a walk-through: placed by its points, then adjusted together with it.

The walk-through alone fixes its own world, for its images lie close to each other. A standing camera is placed by
points that at least three other images see, two equations each, which is what false matches of a pair cannot imitate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Float64s
from .adjustment import Adjusted, adjust
from .colmap import load_pycolmap
from .evidence import aligned_distances, centers, diameter
from .hypotheses import OWN_GAINS, gains, thinned
from .lens import Lens
from .mapping import Model
from .moving_solve import MovingSolution
from .release import KNOWN, Released, released
from .tracks import Tracks, located
from .two_view import colmap_camera

_LEAST_POINTS = 20  # that place a camera
_LEAST_VIEWS = 3  # of a point, before it places one
_LEAST_SHARE = 0.25  # of a camera's matches with such points that agree with its pose


@dataclass(frozen=True, eq=False)
class Joined:
    """Standing cameras, the first ones, and the images of walk-throughs in one world.

    Attributes:
        adjusted: the model and its points.
        own_focals: standing cameras of one kind have focal lengths of their own.
        apart: how far half of the points put a standing camera from where the other half does, over their diameter.
        cost: mean over the observations of the standing cameras, each when it was held out.
    """

    adjusted: Adjusted
    own_focals: bool
    apart: float
    cost: float


def placed(standing: Sequence[Lens], walked: MovingSolution, tracks: Tracks) -> Model:
    """The standing cameras' poses among those of the walk-through; NaN for those that too few points place.

    Args:
        standing: sizes of the cameras, whose focal lengths are not known.
        tracks: of all images, the standing cameras' first.
    """
    known = walked.adjusted.model
    count = len(standing)
    poses = np.concatenate([np.full((count, 3, 4), np.nan), known.poses])
    lenses = [*standing, *known.lenses]
    for _ in range(count):  # one that is placed may bear points that place another
        limits = np.array([lens.limit for lens in lenses])
        points, distances = located(tracks, poses, lenses, limits)
        views = np.bincount(tracks.points[distances <= limits[tracks.cameras]], minlength=tracks.count)
        sure = np.isfinite(points).all(axis=1) & (views >= _LEAST_VIEWS)
        found = {}
        for index in np.flatnonzero(np.isnan(poses[:count, 0, 0])).tolist():
            own = (tracks.cameras == index) & sure[tracks.points]
            answer = _posed(lenses[index], tracks.pixels[own], points[tracks.points[own]])
            if answer is not None:
                found[index] = answer
        for index, (pose, lens) in found.items():
            poses[index], lenses[index] = pose, lens
        if not found:
            break
    return Model(poses, tuple(lenses))


def _posed(lens: Lens, pixels: Float64s, points: Float64s) -> tuple[Float64s, Lens] | None:
    """Pose (3, 4) and focal length of a camera that sees points (N, 3) at pixels (N, 2); None where too few agree."""
    if len(points) < _LEAST_POINTS:
        return None
    pycolmap = load_pycolmap()
    camera = colmap_camera(lens, 1, "SIMPLE_PINHOLE")
    found = pycolmap.estimate_and_refine_absolute_pose(pixels, points, camera, *_pose_options(3 * lens.limit))
    if found is None:
        return None
    inliers = int(found["num_inliers"])
    focal = float(camera.params[0])
    if inliers < max(_LEAST_POINTS, _LEAST_SHARE * len(points)) or not 0.2 < focal / lens.width < 10:
        return None
    return np.asarray(found["cam_from_world"].matrix(), np.float64), replace(lens, focal=focal)


def _pose_options(limit: float) -> tuple[Any, Any]:  # pycolmap.AbsolutePoseEstimationOptions, ...RefinementOptions
    pycolmap = load_pycolmap()
    estimation, refinement = pycolmap.AbsolutePoseEstimationOptions(), pycolmap.AbsolutePoseRefinementOptions()
    estimation.estimate_focal_length = True
    estimation.ransac.max_error = limit
    estimation.ransac.random_seed = 0
    refinement.refine_focal_length = True
    return estimation, refinement


def joined(start: Model, count: int, tracks: Tracks, groups: Sequence[int], walked: MovingSolution) -> Joined:
    """Everything adjusted together, with the distortion that held-out points ask for.

    Args:
        start: of which all standing cameras have a pose.
        count: of standing cameras.
        groups: of all images; cameras of one group share their lens.
    """
    few, _ = thinned(tracks, {}, len(groups))
    coefficients = [0] * count + list(walked.coefficients)

    def fitted(grouping: Sequence[int]) -> Released:
        kinds = [*grouping[:count], *[KNOWN] * (len(grouping) - count)]
        return released(start, few, grouping, kinds, coefficients)

    shared = fitted(groups)
    chosen, grouping = shared, list(groups)
    if len(set(groups[:count])) < count:
        alone = [max(groups) + 1 + index for index in range(count)] + list(groups[count:])
        own = fitted(alone)
        if gains(shared.costs, own.costs, OWN_GAINS):
            chosen, grouping = own, alone
    adjusted = adjust(chosen.fits[0].model, tracks, grouping, chosen.coefficients)
    apart = _apart(chosen.fits[0].model, chosen.fits[1].model, count)
    observations = int((few.cameras < count).sum())
    return Joined(adjusted, chosen is not shared, apart, float(chosen.costs.sum()) / max(observations, 1))


def _apart(one: Model, other: Model, count: int) -> float:
    """How far two models put a standing camera apart at worst, aligned by all images, over the cameras' diameter.

    Of a single standing camera, and of those that stand together, over the walk-through's size.
    """
    both = sorted(set(one.placed) & set(other.placed))
    first, second = (centers(model)[both] for model in (one, other))
    stands = np.array(both) < count
    size = diameter(second[stands] if stands.sum() > 1 else second)
    return float(aligned_distances(first, second)[stands].max() / max(size, 1e-300))
