"""The structs of the native code's interface (src/frog_native.h, src/shared/types.h), as ctypes sees them.

The library takes them by address, the CUDA kernels by value; a test compares their layout with what a compiler says.
"""

from collections.abc import Mapping
from ctypes import Structure, addressof, c_char, c_float, c_int32, c_int64, c_void_p
from typing import Protocol, TypeAlias

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera as CaptureCamera
from ..gaussians import ATTRIBUTES, AnyGaussians
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


def _named(kind: type, names: str) -> list[tuple[str, type]]:
    return [(name, kind) for name in names.split()]


def _struct(name: str, *fields: tuple[str, type]) -> type[Structure]:
    return type(name, (Structure,), {"_fields_": list(fields)})


Gaussians = _struct("FrogGaussians", *_named(c_int32, "count sh_count"), *[(name, c_void_p) for name in ATTRIBUTES])
"""Addresses of (N, 3), (N, 4), (N, 3), (N,) and (N, K, 3) float32 arrays."""
Camera = _struct(
    "FrogCamera", ("world_to_camera", c_float * 12), *_named(c_float, "fx fy cx cy"), *_named(c_int32, "width height")
)
"""The upper rows of world_to_camera, row-major; focal lengths and principal point in pixels."""
Options = _struct(
    "FrogOptions",
    ("background", c_float * 3),
    *_named(c_float, "low_pass near_plane"),
    ("region", c_int32 * 4),
    *_named(c_void_p, "depth_limit low_passes"),
)
"""``region`` is left, top, width, height; ``depth_limit`` and ``low_passes`` are addresses or None."""
Image = _struct("FrogImage", *_named(c_void_p, "rgb alpha median_index mean_depth max_weights radii"))
ImageGradient = _struct("FrogImageGradient", *_named(c_void_p, "rgb alpha"), ("slot_limit", c_int64))
Gradients = _struct("FrogGradients", *_named(c_void_p, "means quaternions scales opacities sh screen pose"))
_FIELD_ARRAYS = _named(
    c_void_p,
    "means log_scales quaternions opacity_logits sh embeddings shared "
    "embedding_weight head_weight head_bias output_weight output_bias",
)
Field = _struct(
    "FrogDeformation",
    *_named(c_int32, "count num_dynamic embedding_size hidden_width head_width networks"),
    *_named(c_int32, "sh_count sh_active sh_deformed opacity_form unit_quaternions precomputed_first_layer"),
    *_named(c_int32, "temporal_size"),
    *_named(c_float, "opacity_sharpness opacity_share motion_unit"),
    *_FIELD_ARRAYS,
    *_named(c_void_p, "groups temporal temporal_weight modulation_weight"),
)
Deformed = _struct("FrogDeformed", *_named(c_void_p, "means quaternions scales opacities sh changes"))
FieldGradients = _struct("FrogDeformationGradients", *_FIELD_ARRAYS)
FieldSizes = _struct(
    "FieldSizes",
    *_named(c_int32, "count num_dynamic embedding_size units networks temporal_size table_rows fusion"),
    *_named(c_int32, "sh_count sh_active sh_deformed opacity_form"),
    *_named(c_float, "opacity_sharpness opacity_share motion_unit"),
    *[("rows", c_int32 * 8), ("weights", c_float * 8)],
)
"""For the CUDA kernels, as are the arrays: which rows of the temporal table, with which weights, make an embedding."""
FieldArrays = _struct(
    "FieldArrays",
    *_named(c_void_p, "means log_scales quaternions opacity_logits sh embeddings temporal_table temporal_weight bias"),
    *_named(c_void_p, "embedding_weight modulation_weight output_weight output_bias"),
)
Adam = _struct(
    "FrogAdam",
    *_named(c_void_p, "values gradients first second"),
    ("size", c_int64),
    *_named(c_float, "first_share second_share rate second_scale epsilon"),
)
L1Loss = _struct(
    "FrogL1Loss",
    *_named(c_int32, "height width"),
    *[*_named(c_void_p, "image truth"), ("truth_row", c_int64), ("weight", c_float)],
    *_named(c_void_p, "gradient cells truth_floats"),
)
Pixels = _struct("FrogPixels", ("first", c_void_p), ("row", c_int64), *_named(c_int32, "height width channels"))
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


def pointers(struct: type[Structure], arrays: Mapping[str, Buffer | int | None], **others: float) -> Structure:
    """A struct of the addresses of ``arrays``, by the fields' names; null where there is none.

    Args:
        others: its fields that are no addresses; zero where there is none.
    """
    addresses = {name: address(arrays.get(name)) for name, kind, *_ in struct._fields_ if kind is c_void_p}
    return struct(**others, **addresses)


def gaussians_struct(gaussians: AnyGaussians) -> Structure:
    """From a ``GaussianArrays`` of contiguous float32 arrays, which must outlive the struct's use."""
    addresses = [address(getattr(gaussians, name)) for name in ATTRIBUTES]
    return Gaussians(len(gaussians), gaussians.sh.shape[1], *addresses)


def camera_struct(camera: CaptureCamera) -> Structure:
    """From a ``capture.camera.Camera``."""
    k = camera.intrinsics
    rows = (c_float * 12)(*camera.world_to_camera[:3].ravel())
    return Camera(rows, k[0, 0], k[1, 1], k[0, 2], k[1, 2], camera.width, camera.height)


def options_struct(
    options: RasterizeOptions,
    background: tuple[float, float, float],
    region: tuple[int, int, int, int],
    low_pass: float | Buffer,
) -> Structure:
    """From ``RasterizeOptions``, its region of the camera, and the Gaussians', as one number or an array (N,)."""
    one, each = (low_pass, None) if isinstance(low_pass, int | float) else (0.0, low_pass)
    numbers = one, options.near_plane, (c_int32 * 4)(*region)
    native = Options((c_float * 3)(*background), *numbers, address(options.depth_limit), address(each))
    native.arrays = options.depth_limit, each  # kept as long as it is
    return native
