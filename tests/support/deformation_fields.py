"""Random deformation fields as plain arrays, as the native library takes them. No torch."""

import numpy as np

from frog_blender.engine.native.deformation import FieldShape
from frog_blender.engine.playback.deformation import pack_lanes, transpose_weights


def field_arrays(
    shape: FieldShape, hidden: int, embedding: int, count: int = 500, sh_count: int = 16, seed: int = 0
) -> dict[str, np.ndarray]:
    """The canonical field's attributes and the network's weights by name, changes about as large as what they change.

    Args:
        hidden, embedding: units of each network's first layer, and length of a Gaussian's embedding.
        sh_count: coefficients that are stored.
    """
    random, units = np.random.default_rng(seed), shape.networks * hidden
    sizes: dict[str, tuple[int, ...]] = {"means": (count, 3), "log_scales": (count, 3), "quaternions": (count, 4)}
    sizes |= {"opacity_logits": (count,), "sh": (count, sh_count, 3), "embeddings": (count, embedding)}
    sizes |= {"shared": (units,), "embedding_weight": (units, embedding), "output_bias": (shape.outputs,)}
    sizes |= {"output_weight": (shape.outputs, shape.networks * (shape.head_width or hidden))}
    if shape.head_width:
        width = shape.networks * shape.head_width * (5 if shape.sh_deformed else 4)
        sizes |= {"head_weight": (width, hidden), "head_bias": (width,)}
    return {name: np.float32(random.normal(0, 0.3, size)) for name, size in sizes.items()}


def output_arrays(shape: FieldShape, count: int, changes: bool = False) -> dict[str, np.ndarray]:
    """What ``deform`` fills: NaN until then."""
    sizes: dict[str, tuple[int, ...]] = {"means": (count, 3), "quaternions": (count, 4), "scales": (count, 3)}
    sizes |= {"opacities": (count,), "sh": (count, shape.sh_active, 3)}
    sizes |= {"changes": (count, shape.outputs)} if changes else {}
    return {name: np.full(size, np.nan, np.float32) for name, size in sizes.items()}


def in_groups(shape: FieldShape, arrays: dict[str, np.ndarray], kept: bool) -> dict[str, np.ndarray]:
    """The same field with all that is of a Gaussian in groups."""
    colors = np.ascontiguousarray(arrays["sh"][:, : shape.sh_deformed])
    return {"means": arrays["means"], "groups": pack_lanes(arrays | {"sh": colors}, kept)} | transpose_weights(arrays)
