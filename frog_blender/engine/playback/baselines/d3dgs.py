"""Deformable-3DGS at playback; see ``model.baselines.d3dgs``. Encoded positions do not change in time and are kept."""

from __future__ import annotations

import numpy as np

from ...arrays import Array, SceneArrays
from ...gaussians import NumpyGaussians
from ...io.plain_values import JsonMapping
from .arrays import StaticGaussians, in_blocks, number, readable, take, whole

_SIZES = {"means": 3, "quaternions": 4, "log_scales": 3}
_WIDEST = 4096


def _encode(values: Array, frequencies: int) -> Array:
    """(N, D) to (N, D + 2 D frequencies): values, sines, cosines."""
    octaves = (2.0 ** np.arange(frequencies)).astype(np.float32)
    angles = (values[:, :, None] * octaves).reshape(len(values), -1)
    return np.concatenate([values, np.sin(angles), np.cos(angles)], axis=1)


class PlayableD3dgs:
    """Deformed Gaussians at a time, as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    changing = frozenset(name.removeprefix("log_") for name in _SIZES)

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        with readable("deformation network"):
            self._still = StaticGaussians(arrays)
            self.num_dynamic = len(self._still)
            depth, width = whole(model, "depth", 1, 64), whole(model, "width", 1, _WIDEST)
            space = 3 + 6 * whole(model, "space_frequencies", 0, 24)
            self._frequencies = whole(model, "time_frequencies", 0, 24)
            self._unit = number(model, "motion_unit")
            encoded_time = 1 + 2 * self._frequencies
            self._skips = (0, depth // 2 + 1)
            self._layers = []
            for layer in range(depth):
                inputs = (space + encoded_time) * (layer in self._skips) + width * (layer > 0)
                weight = take(arrays, f"network.layers.{layer}.weight", width, inputs)
                bias = take(arrays, f"network.layers.{layer}.bias", width)
                splits = [space, space + encoded_time] if layer in self._skips else [0, 0]
                self._layers.append((*np.split(weight, splits, axis=1), bias))
            outputs = sum(_SIZES.values())
            self._output = take(arrays, "network.output.weight", outputs, width)
            self._output_bias = take(arrays, "network.output.bias", outputs)
            centre, unit = (take(arrays, f"network.{name}", 3) for name in ("centre", "unit"))
            if not (unit > 0).all():
                raise ValueError("its unit of length is not above 0")
            self._places = _encode((self._still.means - centre) / unit, int(model["space_frequencies"]))

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        encoded_time = _encode(np.full((1, 1), time, np.float32), self._frequencies)[0]
        constants = [
            bias + by_time @ encoded_time if by_time.size else bias
            for by_place, by_time, by_hidden, bias in self._layers
        ]

        def network(part: slice) -> Array:
            places, hidden = self._places[part], None
            for (by_place, _, by_hidden, _), constant in zip(self._layers, constants, strict=True):
                sums = places @ by_place.T if by_place.size else 0
                if hidden is not None:
                    sums += hidden @ by_hidden.T
                sums += constant
                hidden = np.maximum(sums, 0, out=sums)
            return hidden @ self._output.T + self._output_bias

        output = in_blocks(len(self._still), len(self._output), network)
        return self._still.changed(_SIZES, output, self._unit)
