"""A finished scene, played: time in, Gaussians out. Numpy and the native library alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.time import frame_to_time
from ..files import SceneFile, SceneHeader, read_scene
from ..rasterizer.arrays import GaussianArrays
from .deformation import PlayableDeformation
from .rivals import RIVALS

PLAYABLE: dict[str, Callable[[dict[str, np.ndarray], dict], Any]] = {"frog": PlayableDeformation, **RIVALS}
"""What moves a scene, by the method in its header; a method that is not here has nothing that moves."""


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
        playable = PLAYABLE.get(scene.header.method)
        self._deformation = playable(scene.arrays, scene.header.model) if playable else None

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
        if self._deformation is not None:
            gaussians = self._deformation.at(time)
        else:
            opacities = 1 / (1 + np.exp(-np.clip(a["opacity_logits"], -80, 80)))
            gaussians = GaussianArrays(a["means"], a["quaternions"], np.exp(a["log_scales"]), opacities, a["sh"])
        lengths = np.linalg.norm(gaussians.quaternions, axis=1, keepdims=True)
        gaussians.quaternions = gaussians.quaternions / np.maximum(lengths, 1e-12)
        return gaussians.checked()
