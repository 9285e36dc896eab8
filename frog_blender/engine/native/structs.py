"""The structs of the native code's interface (src/frog_native.h, src/shared/types.h), as ctypes sees them.

The library takes them by address, the CUDA kernels by value; a test compares their layout with what a compiler says.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import Structure, addressof, c_char, c_float, c_int32, c_int64, c_void_p
from typing import Protocol, TypeAlias

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera as CaptureCamera
from ..gaussians import AnyGaussians
from .options import RasterizeOptions


class TensorLike(Protocol):
    """A torch tensor, as far as the library is concerned, which does without torch."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    def __len__(self) -> int: ...
    def data_ptr(self) -> int: ...


Buffer: TypeAlias = Array | TensorLike
"""An array whose address is given to the library: contiguous, and of the type that its struct says."""

SPLAT_FLOATS = 16  # a Splat takes 64 bytes
ATTRIBUTES = ("means", "quaternions", "scales", "opacities", "sh")


def _struct(name: str, *fields: tuple[str, type]) -> type[Structure]:
    return type(name, (Structure,), {"_fields_": list(fields)})


class Gaussians(Structure):
    """``FrogGaussians``: addresses of (N, 3), (N, 4), (N, 3), (N,) and (N, K, 3) float32 arrays."""

    _fields_ = [("count", c_int32), ("sh_count", c_int32), *[(name, c_void_p) for name in ATTRIBUTES]]


class Camera(Structure):
    """``FrogCamera``: the upper rows of world_to_camera, row-major; focal lengths and principal point in pixels."""

    _fields_ = [
        ("world_to_camera", c_float * 12),
        *[(name, c_float) for name in ("fx", "fy", "cx", "cy")],
        *[(name, c_int32) for name in ("width", "height")],
    ]


class Options(Structure):
    """``FrogOptions``; ``region`` is left, top, width, height, and ``depth_limit`` an address or None."""

    _fields_ = [
        ("background", c_float * 3),
        ("low_pass", c_float),
        ("near_plane", c_float),
        ("region", c_int32 * 4),
        ("depth_limit", c_void_p),
    ]


IMAGE = ("rgb", "alpha", "median_index", "mean_depth", "max_weights", "radii")
Image = _struct("FrogImage", *[(name, c_void_p) for name in IMAGE])
ImageGradient = _struct("FrogImageGradient", ("rgb", c_void_p), ("alpha", c_void_p), ("slot_limit", c_int64))
GRADIENTS = (*ATTRIBUTES, "screen", "pose")
Gradients = _struct("FrogGradients", *[(name, c_void_p) for name in GRADIENTS])
FIELD_SIZES = (
    *("count", "num_dynamic", "embedding_size", "hidden_width", "head_width", "networks"),
    *("sh_count", "sh_active", "sh_deformed", "opacity_form", "unit_quaternions", "precomputed_first_layer"),
    "temporal_size",
)
FIELD_ARRAYS = (
    *("means", "log_scales", "quaternions", "opacity_logits", "sh", "embeddings", "shared"),
    *("embedding_weight", "head_weight", "head_bias", "output_weight", "output_bias"),
)
MOMENT_ARRAYS = ("temporal", "temporal_weight", "modulation_weight")
Field = _struct(
    "FrogDeformation",
    *[(name, c_int32) for name in FIELD_SIZES],
    *[(name, c_float) for name in ("opacity_sharpness", "opacity_share", "motion_unit")],
    *[(name, c_void_p) for name in (*FIELD_ARRAYS, "groups", "active", *MOMENT_ARRAYS)],
)
DEFORMED = (*ATTRIBUTES, "changes", "was_visible")
Deformed = _struct("FrogDeformed", *[(name, c_void_p) for name in DEFORMED])
FieldGradients = _struct("FrogDeformationGradients", *[(name, c_void_p) for name in FIELD_ARRAYS])
Adam = _struct(
    "FrogAdam",
    *[(name, c_void_p) for name in ("values", "gradients", "first", "second")],
    ("size", c_int64),
    *[(name, c_float) for name in ("first_share", "second_share", "rate", "second_scale", "epsilon")],
)
L1Loss = _struct(
    "FrogL1Loss",
    *[(name, c_int32) for name in ("height", "width")],
    *[("image", c_void_p), ("truth", c_void_p), ("truth_row", c_int64), ("weight", c_float)],
    *[(name, c_void_p) for name in ("gradient", "cells", "truth_floats")],
)
Pixels = _struct(
    "FrogPixels",
    *[("first", c_void_p), ("row", c_int64)],
    *[(name, c_int32) for name in ("height", "width", "channels")],
)
OPACITY_FORMS = {"off": 0, "paper": 1, "unit": 2}


def address(array: Buffer | int | None) -> int | None:
    """Where an array's numbers lie; an address stays one, and None is null."""
    if array is None or isinstance(array, int):
        return array
    if not isinstance(array, np.ndarray):
        return array.data_ptr()
    try:
        return addressof(c_char.from_buffer(array.data))  # a third of the time, for a dozen arrays a frame
    except (TypeError, ValueError):  # read-only, or empty
        return int(array.__array_interface__["data"][0])


def pointers(struct: type[Structure], names: tuple[str, ...], arrays: Mapping[str, Buffer | int | None]) -> Structure:
    """A struct of the addresses of ``arrays`` in the order of ``names``; null where there is none."""
    return struct(*[address(arrays.get(name)) for name in names])


def gaussians_struct(gaussians: AnyGaussians) -> Gaussians:
    """From a ``GaussianArrays`` of contiguous float32 arrays, which must outlive the struct's use."""
    addresses = [address(getattr(gaussians, name)) for name in ATTRIBUTES]
    return Gaussians(len(gaussians), gaussians.sh.shape[1], *addresses)


def camera_struct(camera: CaptureCamera) -> Camera:
    """From a ``capture.camera.Camera``."""
    k = camera.intrinsics
    rows = (c_float * 12)(*camera.world_to_camera[:3].ravel())
    return Camera(rows, k[0, 0], k[1, 1], k[0, 2], k[1, 2], camera.width, camera.height)


def options_struct(
    options: RasterizeOptions,
    background: tuple[float, float, float],
    region: tuple[int, int, int, int],
    depth_limit: Buffer | None,
) -> Options:
    """From ``RasterizeOptions``, its region of the camera, and an array or None, which must outlive it."""
    return Options(
        (c_float * 3)(*background),
        options.low_pass,
        options.near_plane,
        (c_int32 * 4)(*region),
        address(depth_limit),
    )
