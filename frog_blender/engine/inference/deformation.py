"""The deformation network at playback: numpy and the native library, the first layer's Gaussian part cached."""

from __future__ import annotations

import numpy as np

from ..errors import FrogError
from ..model.temporal import temporal_weights
from ..rasterizer.native import Network

_HEAD_ORDER = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
_ALIGNMENT = 16  # the library takes outputs in multiples of this


def _padded(array: np.ndarray, axis: int) -> np.ndarray:
    missing = -array.shape[axis] % _ALIGNMENT
    widths = [(0, missing if i == axis else 0) for i in range(array.ndim)]
    return np.ascontiguousarray(np.pad(array, widths), dtype=np.float32)


def _check_shapes(arrays: dict[str, np.ndarray], model: dict) -> None:
    """KeyError or ValueError unless every array is what the settings say; the library only sees addresses."""
    hidden, heads, deformed = int(model["hidden_width"]), int(model["head_width"]), int(model["deformed_sh"])
    embedding, temporal = int(model["embedding_size"]), int(model["temporal_size"])
    sizes = 11 + 3 * deformed  # means 3, scales 3, quaternions 4, opacity 1
    expected = {
        "embeddings": (len(arrays["means"]), embedding),
        "temporal_table": (int(model["temporal_rows"]), temporal),
        "network.embedding_weight": (hidden, embedding),
        "network.temporal_weight": (hidden, temporal),
        "network.bias": (hidden,),
        "network.output_weight": (sizes, heads or hidden),
        "network.output_bias": (sizes,),
    }
    if heads:
        width = heads * (5 if deformed else 4)
        expected |= {"network.head_weight": (width, hidden), "network.head_bias": (width,)}
    for name, shape in expected.items():
        if arrays[name].shape != shape or 0 in shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, expected {shape}")
    if not 0 <= deformed <= arrays["sh"].shape[1] or not 1 <= int(model["coarse_rows"]) <= int(model["temporal_rows"]):
        raise ValueError("it deforms more colours or resamples to more rows than there are")
    if (
        not 0 <= int(model.get("fine_rows", 0)) <= int(model["temporal_rows"])
        or not 0 <= float(model.get("opacity_share", 1.0)) <= 1
    ):
        raise ValueError("its schedules stand where they cannot")
    if model["opacity_reduction"] not in ("paper", "unit", "off") or not float(model["opacity_sharpness"]) >= 0:
        raise ValueError(f"the opacity reduction is {model['opacity_reduction']!r}, {model['opacity_sharpness']}")


class PlayableDeformation:
    """Changes of every Gaussian at a time, exactly as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    def __init__(self, arrays: dict[str, np.ndarray], model: dict) -> None:
        try:
            _check_shapes(arrays, model)
            self._table = arrays["temporal_table"].astype(np.float32)
            embedding_weight = arrays["network.embedding_weight"]
            self._temporal_weight = arrays["network.temporal_weight"]
            self._bias = arrays["network.bias"]
            self._rows = (int(model["coarse_rows"]), int(model.get("fine_rows", 0)) or int(model["temporal_rows"]))
            self.motion_unit = float(model["motion_unit"])
            sizes = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1, "sh": 3 * model["deformed_sh"]}
            self.sizes = {name: sizes[name] for name in _HEAD_ORDER if sizes[name]}
            # (N, hidden): does not depend on time.
            self._first = _padded(arrays["embeddings"] @ embedding_weight.T, 1)
            self._network = self._build(arrays, int(model["head_width"]))
        except (KeyError, ValueError, TypeError) as error:
            raise FrogError(f"The scene's deformation network cannot be used ({error}); train it again.") from error

    def _build(self, arrays: dict[str, np.ndarray], head_width: int) -> Network:
        hidden = self._first.shape[1]
        outputs = sum(self.sizes.values())
        weight, bias = arrays["network.output_weight"], arrays["network.output_bias"]
        layers: list[tuple[int, int, np.ndarray, np.ndarray, bool]] = []
        end = hidden
        if head_width:
            head_weight = _padded(_padded(arrays["network.head_weight"].T, 0)[:hidden], 1)
            layers.append((0, hidden, head_weight, _padded(arrays["network.head_bias"], 0), True))
            # One block-diagonal layer for all heads: the few zeros cost less than five calls.
            block = np.zeros((head_weight.shape[1], outputs), np.float32)
            row = 0
            for number, size in enumerate(self.sizes.values()):
                block[number * head_width : (number + 1) * head_width, row : row + size] = weight[row : row + size].T
                row += size
            weight, source, end = block.T, hidden, hidden + head_weight.shape[1]
        else:
            source = 0
            weight = np.pad(weight, ((0, 0), (0, hidden - weight.shape[1])))
        output_weight = _padded(weight.T, 1)
        layers.append((source, end, output_weight, _padded(bias, 0), False))
        self._output_length = output_weight.shape[1]
        return Network(hidden, layers, end + self._output_length, self._output_length)

    def at(self, time: float) -> dict[str, np.ndarray]:
        """Changes (N, size) by attribute at a time in [0, 1]; means in world units."""
        table_rows = len(self._table)
        coarse, fine = (temporal_weights(time, rows, table_rows) @ self._table for rows in self._rows)
        shared = _padded(self._temporal_weight @ (coarse * fine) + self._bias, 0)
        result = np.empty((len(self._first), self._output_length), np.float32)
        self._network.evaluate(self._first, shared, result)
        changes, start = {}, 0
        for name, size in self.sizes.items():
            changes[name] = result[:, start : start + size]
            start += size
        changes["means"] = changes["means"] * np.float32(self.motion_unit)
        return changes
