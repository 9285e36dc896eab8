"""A finished scene, played: time in, Gaussians out. Numpy and the native library alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..capture.time import frame_to_time
from ..files import SceneFile, SceneHeader, read_scene
from ..rasterizer.arrays import GaussianArrays
from .deformation import PlayableDeformation


class PlayableScene:
    """Stateless: any time, in any order, from any thread.

    Attributes:
        header: the scene file's header.
        count: Gaussians.
    """

    def __init__(self, scene: SceneFile) -> None:
        self.header: SceneHeader = scene.header
        self._arrays = scene.arrays
        self.count = len(scene.arrays["means"])
        self._deformation = (
            PlayableDeformation(scene.arrays, scene.header.model) if scene.header.method == "frog" else None
        )

    @classmethod
    def load(cls, path: str | Path) -> PlayableScene:
        """FrogError in one sentence when the file cannot be used."""
        return cls(read_scene(path))

    def at_frame(self, frame: float) -> GaussianArrays:
        """Gaussians at a frame counted from 0; fractions are legal, frames outside are held."""
        return self.at(frame_to_time(frame, self.header.frame_count))

    def at(self, time: float) -> GaussianArrays:
        """Gaussians at a time in [0, 1] (clamped): unit quaternions, scales and opacities activated."""
        a = self._arrays
        means, log_scales, quaternions = a["means"], a["log_scales"], a["quaternions"]
        logits, sh = a["opacity_logits"], a["sh"]
        factor: np.ndarray | np.float32 = np.float32(1)
        if self._deformation is not None:
            changes = self._deformation.at(time)
            means = means + changes["means"]
            log_scales = log_scales + changes["log_scales"]
            quaternions = quaternions + changes["quaternions"]
            d_opacity = changes["opacity_logits"][:, 0]
            logits = logits + d_opacity
            factor = self._reduction(d_opacity)
            if "sh" in changes:
                sh = sh.copy()
                deformed = changes["sh"].shape[1] // 3
                sh[:, :deformed] += changes["sh"].reshape(self.count, deformed, 3)
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        return GaussianArrays(
            means,
            quaternions / np.maximum(lengths, 1e-12),
            np.exp(log_scales),
            _sigmoid(logits) * factor,
            sh,
        ).checked()

    def _reduction(self, d_opacity: np.ndarray) -> np.ndarray | np.float32:
        """The opacity reduction of model.opacity, which says what the forms are."""
        form, sharpness = self.header.model["opacity_reduction"], np.float32(self.header.model["opacity_sharpness"])
        if form == "off":
            return np.float32(1)
        factor = _sigmoid(sharpness * d_opacity)
        if form == "unit":
            factor = np.minimum(np.float32(1), 2 * factor)
        return 1 + np.float32(self.header.model.get("opacity_share", 1.0)) * (factor - 1)


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(x, -80, 80)))
