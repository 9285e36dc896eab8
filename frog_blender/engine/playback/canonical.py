"""Gaussians that nothing moves: the canonical field as it is."""

from __future__ import annotations

import numpy as np

from ..gaussians import GaussianArrays


def canonical_gaussians(arrays: dict[str, np.ndarray]) -> GaussianArrays:
    """The canonical field of a scene file's arrays, activated, with unit quaternions."""
    opacities = 1 / (1 + np.exp(-np.clip(arrays["opacity_logits"], -80, 80)))
    scales = np.exp(np.clip(arrays["log_scales"], -80, 80))  # as the native library does
    return GaussianArrays(
        arrays["means"], normalize(arrays["quaternions"]), scales, opacities.astype(np.float32), arrays["sh"]
    )


def normalize(quaternions: np.ndarray) -> np.ndarray:
    """(N, 4) of length one."""
    return quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
