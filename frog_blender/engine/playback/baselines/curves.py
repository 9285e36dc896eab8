"""SpacetimeGaussians at playback; see ``model.baselines.curves``."""

from __future__ import annotations

import numpy as np

from ...arrays import SceneArrays
from ...gaussians import GaussianArrays, NumpyGaussians
from ...io.plain_values import JsonMapping
from .arrays import StaticGaussians, number, readable, scales_of, sigmoid, take

_NUMBERS = 15


class PlayableCurves:
    """The Gaussians on their curves, as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    changing = frozenset({"means", "quaternions", "base"})

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        with readable("curves"):
            count = self.num_dynamic = len(StaticGaussians(arrays))
            embeddings = take(arrays, "embeddings", count, _NUMBERS)
            units = [number({"motion_units": unit}, "motion_units") for unit in model["motion_units"]]
            if len(units) != 3:
                raise ValueError(f"there are {len(units)} motion units, expected 3")
            self._curve = [embeddings[:, 3 * i : 3 * i + 3] * np.float32(unit) for i, unit in enumerate(units)]
            self._spin = embeddings[:, 9:13] * np.float32(number(model, "rotation_unit"))
            self._centres = embeddings[:, 13:14] * np.float32(number(model, "centre_unit"))
            widths = np.clip(np.float32(-number(model, "width_unit")) * embeddings[:, 14:15], -40, 40)
            self._sharpness = np.exp(widths) / np.float32(number(model, "first_width"))
            self._still = {name: np.ascontiguousarray(arrays[name], np.float32) for name in ("means", "quaternions")}
            self._scales = scales_of(np.asarray(arrays["log_scales"], np.float32))
            self._opacities = sigmoid(np.asarray(arrays["opacity_logits"], np.float32))
            self._sh = np.ascontiguousarray(arrays["sh"], np.float32)

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        since = np.float32(time - 0.5) - self._centres
        first, second, third = self._curve
        means = self._still["means"] + since * (first + since * (second + since * third))
        presence = np.exp(-np.square(since * self._sharpness))[:, 0]
        return GaussianArrays(
            means, self._still["quaternions"] + since * self._spin, self._scales, self._opacities * presence, self._sh
        )
