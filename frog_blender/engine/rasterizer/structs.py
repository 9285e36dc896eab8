"""The structs of the native library's interface (src/frog_native.h, src/shared/types.h), as ctypes sees them."""

from __future__ import annotations

import ctypes
from ctypes import c_float, c_int32, c_void_p
from typing import Any


def _struct(name: str, *fields: tuple[str, Any]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields)})


Gaussians = _struct(
    "FrogGaussians",
    ("count", c_int32),
    ("sh_count", c_int32),
    *[(name, c_void_p) for name in ("means", "quaternions", "scales", "opacities", "sh")],
)
Camera = _struct(
    "FrogCamera",
    ("world_to_camera", c_float * 12),
    *[(name, c_float) for name in ("fx", "fy", "cx", "cy")],
    ("width", c_int32),
    ("height", c_int32),
)
Options = _struct(
    "FrogOptions",
    ("background", c_float * 3),
    ("low_pass", c_float),
    ("near_plane", c_float),
    ("compensate", c_int32),
    ("region", c_int32 * 4),
    ("depth_limit", c_void_p),
)
IMAGE = ("rgb", "alpha", "median_index", "mean_depth", "max_weights", "radii", "at_fault")
Image = _struct("FrogImage", *[(name, c_void_p) for name in IMAGE])
ImageGradient = _struct("FrogImageGradient", ("rgb", c_void_p), ("alpha", c_void_p))
GRADIENTS = ("means", "quaternions", "scales", "opacities", "sh", "screen", "screen_absolute", "pose")
Gradients = _struct("FrogGradients", *[(name, c_void_p) for name in GRADIENTS])
FIELD_SIZES = (
    *("count", "embedding_size", "hidden_width", "head_width", "sh_count", "sh_active", "sh_deformed", "opacity_form"),
)
FIELD_ARRAYS = (
    *("means", "log_scales", "quaternions", "opacity_logits", "sh", "embeddings", "shared"),
    *("embedding_weight", "head_weight", "head_bias", "output_weight", "output_bias"),
)
Field = _struct(
    "FrogDeformation",
    *[(name, c_int32) for name in FIELD_SIZES],
    *[(name, c_float) for name in ("opacity_sharpness", "opacity_share", "motion_unit")],
    *[(name, c_void_p) for name in FIELD_ARRAYS],
)
DEFORMED = ("means", "quaternions", "scales", "opacities", "sh", "changes")
Deformed = _struct("FrogDeformed", *[(name, c_void_p) for name in DEFORMED])
FIELD_GRADIENTS = (
    *("means", "log_scales", "quaternions", "opacity_logits", "sh", "embeddings", "shared", "embedding_weight"),
    *("head_weight", "head_bias", "output_weight", "output_bias"),
)
FieldGradients = _struct("FrogDeformationGradients", *[(name, c_void_p) for name in FIELD_GRADIENTS])
OPACITY_FORMS = {"off": 0, "paper": 1, "unit": 2}


def address(array: Any) -> int | None:
    """Where an array's numbers lie; None for None."""
    if array is None:
        return None
    return array.data_ptr() if hasattr(array, "data_ptr") else array.ctypes.data


def pointers(struct: type[ctypes.Structure], names: tuple[str, ...], arrays: dict[str, Any]) -> ctypes.Structure:
    """A struct of the addresses of ``arrays`` in the order of ``names``; null where there is none."""
    return struct(*[address(arrays.get(name)) for name in names])
