"""The native library through ctypes: no torch needed, and the interpreter runs on while it works.

Arrays may be numpy arrays or CPU torch tensors, float32 and contiguous; only their addresses cross the border.
"""

import ctypes
import functools
import os
import sys
from collections.abc import Mapping
from ctypes import POINTER, byref, c_char_p, c_float, c_int32, c_int64, c_void_p
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture.camera import MAX_SIDE, Camera
from ..errors import FrogError, found_instead
from ..gaussians import AnyGaussians
from ..io.regular_file import regular_file
from . import structs
from .options import RasterizeOptions
from .structs import Buffer

ABI_VERSION = 23
CELL = 16  # FROG_CELL: pixels a side of the cells of ``l1_loss``, which are the rasterizer's tiles
_EXPECTED = "the native rasterizer"
MANY_INSTANCES = 60_000_000
"""(Gaussian, tile) pairs of an image that takes seconds; a scene of a million Gaussians at 4K has a third of them."""
SLOT_LIMIT = 6_000_000  # (Gaussian, tile) pairs that a backward pass keeps gradients of at a time, 36 bytes each


def library_path() -> Path:
    """Where the library lies: where FROG_NATIVE_LIBRARY says; beside this file; in the installed package, for a clone
    in which nothing was built hides it; or in the package frog_blender_native, whose wheel the extension brings along.
    """
    name = {"win32": "frog_native.dll", "darwin": "libfrog_native.dylib"}.get(sys.platform, "libfrog_native.so")
    if named := os.environ.get("FROG_NATIVE_LIBRARY"):
        return Path(named)
    if (path := Path(__file__).with_name(name)).exists():
        return path
    for folder in sys.path:
        if (installed := Path(folder, *__name__.split(".")[:-1], name)).exists():
            return installed
    try:
        import frog_blender_native
    except ModuleNotFoundError:
        return path
    return Path(frog_blender_native.library_path())


@functools.cache
def library() -> ctypes.CDLL:
    """The loaded library; FrogError when it is missing or of another version."""
    path = library_path()
    if path.exists():
        regular_file(path, _EXPECTED)  # the system's loader would wait for a pipe
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as error:
        advice = "" if path.exists() else "; build it with 'make'"
        raise FrogError(f"{path}: {_EXPECTED} could not be loaded ({error}){advice}.") from error
    try:
        return _with_signatures(path, loaded)
    except AttributeError as error:
        expected = f"{_EXPECTED}; build it again with 'make'"
        raise found_instead(path, f"another library ({error})", expected) from error


def _with_signatures(path: Path, loaded: ctypes.CDLL) -> ctypes.CDLL:
    """The library, with the types of its functions; AttributeError when it has not all of them, FrogError when it is of
    another version."""
    version = loaded.frog_abi_version()
    if version != ABI_VERSION:
        raise FrogError(
            f"{path}: found interface version {version}, expected {ABI_VERSION}; build it again with 'make'."
        )
    camera, pixels, floats = POINTER(structs.Camera), POINTER(structs.Pixels), POINTER(c_float)
    gaussians, field, deformed = (POINTER(kind) for kind in (structs.Gaussians, structs.Field, structs.Deformed))
    signatures: dict[str, tuple[object, ...]] = {  # what comes back, and the arguments
        "instruction_set": (c_char_p,),
        "set_thread_count": (None, c_int32),
        "draw": (c_void_p, gaussians, camera, POINTER(structs.Options), POINTER(structs.Image), c_int32),
        "backward": (c_int32, c_void_p, gaussians, POINTER(structs.ImageGradient), POINTER(structs.Gradients)),
        "count_instances": (c_int64, c_void_p),
        "count_pairs": (c_int32, c_void_p, POINTER(c_int64)),
        "free": (None, c_void_p),
        "ssim": (c_int32, c_int32, c_int32, *[c_void_p] * 4),
        "mesh_depth": (
            *(c_int32, c_void_p, c_int32, c_void_p, c_int32),
            *(camera, POINTER(c_int32 * 4), c_float, c_void_p),
        ),
        "depth_order": (c_int32, c_void_p, c_int32, POINTER(c_float * 4), c_float, c_void_p, POINTER(c_int32)),
        "deform": (c_int32, field, deformed),
        "deform_backward": (c_int32, field, deformed, POINTER(structs.FieldGradients)),
        "l1_loss": (c_int32, POINTER(structs.L1Loss), floats),
        "adam": (c_int32, POINTER(structs.Adam), c_int32),
        "predict": (c_int32, pixels, c_int32, c_void_p),
        "restore": (c_int32, c_void_p, c_int32, pixels),
    }
    for name, (result, *arguments) in signatures.items():
        function = getattr(loaded, f"frog_{name}")
        function.restype, function.argtypes = result, arguments
    return loaded


def instruction_set() -> str:
    """The kernels in use: "avx512", "avx2" or "baseline" (FROG_INSTRUCTION_SET forces one, before the first call)."""
    name: bytes = library().frog_instruction_set()
    return name.decode()


def set_thread_count(count: int) -> None:
    """Threads of the library's own pool; 0 means one for each core."""
    library().frog_set_thread_count(count)


def check_status(status: int, what: str) -> None:
    """MemoryError or ValueError for what a function of the library returned, where that is not 0."""
    if status == 2:
        raise ValueError(f"{what} is not possible: found sizes that cannot be, expected 1 to {MAX_SIDE} pixels a side")
    if status:
        raise MemoryError(f"{what} ran out of memory")


def ssim(image: Buffer, truth: Buffer, gradient: Buffer) -> float:
    """Mean structural similarity of two images (H, W, 3) in [0, 1], window of 3DGS; fills ``gradient`` (H, W, 3)
    with its gradient by ``image``."""
    height, width = image.shape[:2]
    value = c_float()
    first, second, by_first = (structs.address(array) for array in (image, truth, gradient))
    status = library().frog_ssim(height, width, first, second, ctypes.addressof(value), by_first)
    check_status(status, f"comparing two images of {width} x {height}")
    return value.value


def l1_loss(
    image: Buffer, truth: Array, weight: float, gradient: Buffer, cells: Buffer, truth_floats: Buffer | None = None
) -> float:
    """Mean absolute difference of a drawing (H, W, 3) and the image it should be, in one pass on all threads.

    Args:
        image: contiguous float32.
        truth: (H, W, 3) uint8 in a numpy array whose rows are contiguous.
        weight: of the gradient.
        gradient: (H, W, 3), filled with ``weight`` times the gradient by ``image``.
        cells: (rows, columns) for cells of CELL x CELL pixels, filled with their mean squared differences.
        truth_floats: (H, W, 3), filled with the truth in [0, 1]; or None.
    """
    (height, width, _), absolute = truth.shape, c_float()
    sizes = {tuple(array.shape) for array in (image, gradient, truth_floats) if array is not None}
    if truth.dtype != np.uint8 or truth.strides[1:] != (3, 1) or sizes != {truth.shape}:
        raise ValueError(f"expected images of {truth.shape}, truth in uint8 and rows, found {sizes}, {truth.dtype}")
    if tuple(cells.shape) != (-(-height // CELL), -(-width // CELL)):
        raise ValueError(f"expected a cell for {CELL} x {CELL} pixels of {height} x {width}, found {cells.shape}")
    arrays = {"image": image, "truth": truth, "gradient": gradient, "cells": cells, "truth_floats": truth_floats}
    sizes_of = {"height": height, "width": width, "truth_row": truth.strides[0]}
    comparison = structs.pointers(structs.L1Loss, arrays, **sizes_of, weight=weight)
    status = library().frog_l1_loss(byref(comparison), byref(absolute))
    check_status(status, f"comparing two images of {width} x {height}")
    return absolute.value


def depth_order(points: Array, plane: tuple[float, float, float, float], nearest: float) -> Array:
    """(K,) float32 indices of (N, 3) points not nearer than ``nearest``, the farthest first; equal depths in order.

    Args:
        points: contiguous float32, at most 2^24 of them.
        plane: a point's depth is the first three times it, plus the last.
    """
    if points.dtype != np.float32 or not points.flags.c_contiguous or points.shape[1:] != (3,):
        raise ValueError(f"expected contiguous float32 points (N, 3), found {points.shape}, {points.dtype}")
    if len(points) > 1 << 24:
        raise ValueError(f"expected at most 2^24 points, found {len(points):,}")
    order, seen = np.empty(len(points), np.float32), c_int32()
    status = library().frog_depth_order(
        structs.address(points), len(points), byref((c_float * 4)(*plane)), nearest, structs.address(order), byref(seen)
    )
    check_status(status, f"sorting {len(points):,} points")
    return order[: seen.value]


class Frame:
    """One drawing and what its backward pass needs. Frees itself.

    Args:
        gaussians: contiguous float32 arrays.
        camera: the view.
        background: three floats, display-referred.
        options: how to draw.
        image: arrays by name, with (H, W) of the options' region: ``rgb`` (H, W, 3), ``alpha`` (H, W) and, where
            wanted, ``median_index`` (H, W) int32 with ``mean_depth`` (H, W), ``max_weights`` (N,), ``radii`` (N,).
            They are written here.
        differentiable: whether ``backward`` will be called.
    """

    def __init__(
        self,
        gaussians: AnyGaussians,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        image: Mapping[str, Buffer],
        *,
        differentiable: bool = False,
    ) -> None:
        self._handle = None
        self._free = library().frog_free
        self._arrays = gaussians, options  # kept alive as long as the library may read them
        self._gaussians, self._count = structs.gaussians_struct(gaussians), len(gaussians)
        native_options = structs.options_struct(options, background, options.region_of(camera), gaussians.low_pass)
        drawn = self._gaussians, structs.camera_struct(camera), native_options, structs.pointers(structs.Image, image)
        self._handle = library().frog_draw(*map(byref, drawn), differentiable)
        self._differentiable = differentiable
        if not self._handle:
            raise MemoryError(
                f"drawing {len(gaussians)} Gaussians at {camera.width} x {camera.height} ran out of memory"
            )

    def backward(self, rgb: Buffer, alpha: Buffer | None, gradients: Mapping[str, Buffer | None]) -> None:
        """Fills ``gradients`` from dL/d(rgb, alpha); ``alpha`` is None where the loss does not look at it.

        ``gradients`` are arrays by name: those of the Gaussians, ``screen`` (N, 2), and where wanted ``pose`` (3, 4),
        see Image and rasterize.
        """
        if not self._differentiable:
            raise ValueError("this frame was drawn without what its backward pass needs: expected differentiable=True")
        image_gradient = structs.ImageGradient(structs.address(rgb), structs.address(alpha), SLOT_LIMIT)
        native = self._gaussians, image_gradient, structs.pointers(structs.Gradients, gradients)
        check_status(library().frog_backward(self._handle, *map(byref, native)), "the rasterizer's backward pass")

    @property
    def instances(self) -> int:
        """(Gaussian, tile) pairs that were gone through."""
        return int(library().frog_count_instances(self._handle))

    @property
    def notice(self) -> str:
        """What a user is to know of an image of more than MANY_INSTANCES; "" for any other."""
        if self.instances <= MANY_INSTANCES:
            return ""
        return f"Many of the {self._count:,} Gaussians cover most of the image; drawing it takes seconds."

    def count_pairs(self) -> int:
        """(Gaussian, pixel) pairs that were blended, by going through them once more."""
        pairs = c_int64()
        check_status(library().frog_count_pairs(self._handle, byref(pairs)), "counting a frame's pairs")
        return pairs.value

    def __del__(self) -> None:
        if self._handle:
            self._free(self._handle)
            self._handle = None
