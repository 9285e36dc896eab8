"""The deformation network at playback: numpy and the native library."""

from __future__ import annotations

import numpy as np

from ..errors import FrogError
from ..model.temporal import temporal_weights
from ..rasterizer.arrays import GaussianArrays
from ..rasterizer.native_deformation import FieldShape, deform


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
    """Deformed Gaussians at a time, exactly as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    def __init__(self, arrays: dict[str, np.ndarray], model: dict) -> None:
        try:
            _check_shapes(arrays, model)
            self._shape = FieldShape(
                int(model["head_width"]),
                arrays["sh"].shape[1],
                int(model["deformed_sh"]),
                model["opacity_reduction"],
                float(model["opacity_sharpness"]),
                float(model.get("opacity_share", 1.0)),
                float(model["motion_unit"]),
            )
            self._table = arrays["temporal_table"].astype(np.float32)
            self._temporal_weight, self._bias = arrays["network.temporal_weight"], arrays["network.bias"]
            self._rows = (int(model["coarse_rows"]), int(model.get("fine_rows", 0)) or int(model["temporal_rows"]))
            self._arrays = {
                name.removeprefix("network."): np.ascontiguousarray(array, np.float32)
                for name, array in arrays.items()
                if name != "temporal_table"
            }
        except (KeyError, ValueError, TypeError) as error:
            raise FrogError(f"The scene's deformation network cannot be used ({error}); train it again.") from error

    def at(self, time: float) -> GaussianArrays:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        coarse, fine = (temporal_weights(time, rows, len(self._table)) @ self._table for rows in self._rows)
        shared = (self._temporal_weight @ (coarse * fine) + self._bias).astype(np.float32)
        a = self._arrays
        result = {name: np.empty_like(a[name]) for name in ("means", "quaternions", "sh")}
        result |= {"scales": np.empty_like(a["log_scales"]), "opacities": np.empty_like(a["opacity_logits"])}
        deform(self._shape, a | {"shared": shared}, result)
        return GaussianArrays(**result)
