"""Gaussians that nothing moves: the canonical field as it is."""

from __future__ import annotations

import numpy as np

from ..arrays import Array, SceneArrays
from ..gaussians import GaussianArrays, NumpyGaussians


def canonical_gaussians(arrays: SceneArrays) -> NumpyGaussians:
    """The canonical field of a scene file's arrays, activated, with unit quaternions."""
    opacities = 1 / (1 + np.exp(-np.clip(arrays["opacity_logits"], -80, 80)))
    scales = np.exp(np.clip(arrays["log_scales"], -80, 80))  # as the native library does
    return GaussianArrays(
        arrays["means"], normalize(arrays["quaternions"]), scales, opacities.astype(np.float32), arrays["sh"]
    )


def normalize(quaternions: Array) -> Array:
    """(N, 4) of length one."""
    result: Array = quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
    return result
