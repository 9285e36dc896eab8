"""How sure a result must be: limits beyond which it is refused, and those from which on a warning tells how sure it is.

All verdicts (``verdict``, ``scan_verdict``, ``moving_solve``) ask these questions; their sentences name what to film.
"""

from __future__ import annotations

from .evidence import CameraEvidence

LEAST_SHARED = 15
"""Points that a camera must see together with two other images at once."""
_FEW_SHARED = 60
_UNSURE, _DOUBTFUL = 0.05, 0.02  # standard deviation of a focal length, over it
_APART, _DOUBTFUL_APART = 0.03, 0.005  # of the size of the rig or the path
_LEAST_CLOSING = 0.3
_FEW_AGREEING = 0.5


def is_weak(camera: CameraEvidence) -> bool:
    """Whether too few points connect a camera with two other images at once."""
    return camera.shared_by_three < LEAST_SHARED


def is_doubtful(camera: CameraEvidence) -> bool:
    """Whether so few do that somebody should look at the result."""
    return camera.shared_by_three < _FEW_SHARED


def disagrees(camera: CameraEvidence) -> bool:
    """Whether most of a camera's observations contradict the model."""
    return camera.share < _FEW_AGREEING


def is_contradicted(camera: CameraEvidence) -> bool:
    """Whether triangles of pairs speak against a camera, and too few points about which three cameras agree for it.

    Rotations of pairs that few matches determine are off by degrees, so that they alone prove nothing either.
    """
    is_supported = not is_doubtful(camera) and not disagrees(camera)
    return camera.closing < _LEAST_CLOSING and not is_supported


def is_unsure(focal_uncertainty: float) -> bool:
    """Whether the images leave a focal length open; NaN is open."""
    return not focal_uncertainty <= _UNSURE


def is_apart(apart: float) -> bool:
    """Whether two halves of the points put cameras too far apart, as a share of the rig or the path; NaN is too far."""
    return not apart <= _APART


def doubts(focal_uncertainty: float, apart: float, size: str) -> list[str]:
    """Warnings about a result that is believed.

    Args:
        size: what ``apart`` is a share of, such as "the rig's size".
    """
    found = []
    if focal_uncertainty > _DOUBTFUL:
        found.append(f"The focal length is known within {percent(focal_uncertainty)} only.")
    if apart > _DOUBTFUL_APART:
        found.append(f"Camera positions are known within about {percent(apart)} of {size} only.")
    return found


def percent(share: float) -> str:
    """A share in a sentence."""
    return f"{100 * share:.1f} %" if share < float("inf") else "any amount"
