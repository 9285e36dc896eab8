"""A world for a rig of unknown position, direction and size: z up, y ahead, the origin where the cameras look."""

from __future__ import annotations

import numpy as np

from ...arrays import Float64s
from .evidence import centers
from .mapping import Model

_DISTANCE = 3.0  # world units from the origin to the cameras, as in a room measured in metres
_LEVEL = 0.3  # of the sideways axes' spread, from which they tell what is level
_AGREES = 0.8  # cosine between two guesses of up


def oriented(model: Model, points: Float64s) -> tuple[Model, Float64s]:
    """The model and points (N, 3) in that world.

    Up is what the cameras' sideways axes have in common: people hold cameras level even where they look down. Where all
    look one way, it is the mean of the cameras' own up axes.
    """
    rotations = model.poses[model.placed][:, :, :3]
    basis = _basis(rotations)
    origin = _looked_at(model, points)
    scale = _DISTANCE / max(float(np.median(np.linalg.norm(centers(model)[model.placed] - origin, axis=1))), 1e-12)
    poses = model.poses.copy()
    poses[:, :, 3] = scale * (model.poses[:, :, :3] @ origin + model.poses[:, :, 3])
    poses[:, :, :3] = model.poses[:, :, :3] @ basis.T
    return Model(poses, model.lenses), scale * (points - origin) @ basis.T


def _basis(rotations: Float64s) -> Float64s:
    """(3, 3) the world's axes, a row each, in the model's coordinates."""
    up = -rotations[:, 1].mean(axis=0)
    _, spread, axes = np.linalg.svd(rotations[:, 0])
    up /= max(float(np.linalg.norm(up)), 1e-12)
    if len(rotations) > 2 and spread[1] > _LEVEL * spread[0] and abs(axes[2] @ up) > _AGREES:
        up = axes[2] * np.sign(axes[2] @ up)
    ahead = rotations[:, 2].mean(axis=0)
    ahead = ahead - (ahead @ up) * up
    if np.linalg.norm(ahead) < 0.1:  # the cameras look at each other, or down
        first = rotations[0, 2] - (rotations[0, 2] @ up) * up
        ahead = first if np.linalg.norm(first) > 0.1 else np.cross(up, rotations[0, 0])
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(ahead, up), ahead, up])


def _looked_at(model: Model, points: Float64s) -> Float64s:
    """(3,) the middle of the points that were found, else of the cameras."""
    finite = points[np.isfinite(points).all(axis=1)]
    middle: Float64s = np.median(finite if len(finite) else centers(model)[model.placed], axis=0)
    return middle
