"""The native library through ctypes: no torch needed, and the interpreter runs on while it works.

Arrays may be numpy arrays or CPU torch tensors, float32 and contiguous; only their addresses cross the border.
"""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from ctypes import POINTER, byref, c_char_p, c_float, c_int32, c_int64, c_void_p
from pathlib import Path
from typing import Any

from ..capture.camera import Camera
from ..errors import FrogError
from .arrays import GaussianArrays
from .options import RasterizeOptions

ABI_VERSION = 2


def _struct(name: str, *fields: tuple[str, Any]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields)})


_Gaussians = _struct(
    "FrogGaussians",
    ("count", c_int32),
    ("sh_count", c_int32),
    *[(name, c_void_p) for name in ("means", "quaternions", "scales", "opacities", "sh")],
)
_Camera = _struct(
    "FrogCamera",
    ("world_to_camera", c_float * 12),
    *[(name, c_float) for name in ("fx", "fy", "cx", "cy")],
    ("width", c_int32),
    ("height", c_int32),
)
_Options = _struct(
    "FrogOptions",
    ("background", c_float * 3),
    ("low_pass", c_float),
    ("near_plane", c_float),
    ("compensate", c_int32),
    ("region", c_int32 * 4),
    ("depth_limit", c_void_p),
)
_IMAGE = ("rgb", "alpha", "median_index", "mean_depth", "max_weights", "radii", "at_fault")
_Image = _struct("FrogImage", *[(name, c_void_p) for name in _IMAGE])
_ImageGradient = _struct("FrogImageGradient", ("rgb", c_void_p), ("alpha", c_void_p))
_GRADIENTS = ("means", "quaternions", "scales", "opacities", "sh", "screen", "screen_absolute", "pose")
_Gradients = _struct("FrogGradients", *[(name, c_void_p) for name in _GRADIENTS])
_Layer = _struct(
    "FrogLayer",
    *[(name, c_int32) for name in ("input", "inputs", "output", "outputs", "relu")],
    ("weights", c_void_p),
    ("bias", c_void_p),
)


def library_path() -> Path:
    """Where the library lies: beside this file, or where FROG_NATIVE_LIBRARY says."""
    name = {"win32": "frog_native.dll", "darwin": "libfrog_native.dylib"}.get(sys.platform, "libfrog_native.so")
    return Path(os.environ.get("FROG_NATIVE_LIBRARY") or Path(__file__).parent / name)


@functools.cache
def library() -> ctypes.CDLL:
    """The loaded library; FrogError when it is missing or of another version."""
    path = library_path()
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as error:
        raise FrogError(
            f"{path}: the native rasterizer could not be loaded ({error}); build it with 'make'."
        ) from error
    loaded.frog_abi_version.restype = c_int32
    version = loaded.frog_abi_version()
    if version != ABI_VERSION:
        raise FrogError(
            f"{path}: found interface version {version}, expected {ABI_VERSION}; build it again with 'make'."
        )
    loaded.frog_instruction_set.restype = c_char_p
    loaded.frog_thread_count.restype = c_int32
    loaded.frog_set_thread_count.argtypes = [c_int32]
    loaded.frog_set_thread_count.restype = None
    loaded.frog_draw.argtypes = [POINTER(_Gaussians), POINTER(_Camera), POINTER(_Options), POINTER(_Image)]
    loaded.frog_draw.restype = c_void_p
    loaded.frog_backward.argtypes = [
        c_void_p,
        POINTER(_Gaussians),
        POINTER(_Image),
        POINTER(_ImageGradient),
        POINTER(_Gradients),
    ]
    loaded.frog_backward.restype = c_int32
    loaded.frog_count_work.argtypes = [c_void_p, POINTER(c_int64 * 3)]
    loaded.frog_count_work.restype = None
    loaded.frog_free.argtypes = [c_void_p]
    loaded.frog_free.restype = None
    integer, address = c_int32, c_void_p
    loaded.frog_evaluate_network.argtypes = [
        *(integer, integer, address, address),
        *(integer, POINTER(_Layer), integer, integer, address),
    ]
    loaded.frog_evaluate_network.restype = c_int32
    return loaded


def instruction_set() -> str:
    """The kernels in use: "avx512", "avx2" or "baseline" (FROG_INSTRUCTION_SET forces one, before the first call)."""
    return library().frog_instruction_set().decode()


def set_thread_count(count: int) -> None:
    """Threads of the library's own pool; 0 means one for each core."""
    library().frog_set_thread_count(count)


def _address(array: Any) -> int | None:
    if array is None:
        return None
    return array.data_ptr() if hasattr(array, "data_ptr") else array.ctypes.data


def _pointers(struct: type[ctypes.Structure], names: tuple[str, ...], arrays: dict[str, Any]) -> ctypes.Structure:
    return struct(*[_address(arrays.get(name)) for name in names])


class Frame:
    """One drawing and what its backward pass needs. Frees itself.

    Args:
        gaussians: contiguous float32 arrays.
        camera: the view.
        background: three floats, display-referred.
        options: how to draw.
        image: arrays by name, with (H, W) of the options' region: ``rgb`` (H, W, 3), ``alpha`` (H, W) and, where
            wanted, ``median_index`` (H, W) int32 with ``mean_depth`` (H, W), ``max_weights`` (N,), ``radii`` (N,),
            ``at_fault`` (1,) int32. They are written here.
        depth_limit: (H, W) planar depth beyond which nothing is drawn, or None.
    """

    def __init__(
        self,
        gaussians: GaussianArrays,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        image: dict[str, Any],
        depth_limit: Any = None,
    ) -> None:
        self._handle = None
        self._free = library().frog_free
        self._arrays = gaussians, depth_limit  # kept alive as long as the library may read them
        self._gaussians = _Gaussians(
            len(gaussians),
            gaussians.sh.shape[1],
            *[_address(getattr(gaussians, name)) for name in ("means", "quaternions", "scales", "opacities", "sh")],
        )
        k, w2c = camera.intrinsics, camera.world_to_camera
        native_camera = _Camera(
            (c_float * 12)(*w2c[:3].ravel()), k[0, 0], k[1, 1], k[0, 2], k[1, 2], camera.width, camera.height
        )
        native_options = _Options(
            (c_float * 3)(*background),
            options.low_pass,
            options.near_plane,
            options.compensate,
            (c_int32 * 4)(*options.region_of(camera)),
            _address(depth_limit),
        )
        self._handle = library().frog_draw(
            byref(self._gaussians),
            byref(native_camera),
            byref(native_options),
            byref(_pointers(_Image, _IMAGE, image)),
        )
        if not self._handle:
            raise MemoryError(
                f"drawing {len(gaussians)} Gaussians at {camera.width} x {camera.height} ran out of memory"
            )

    def backward(self, image: dict[str, Any], rgb: Any, alpha: Any, gradients: dict[str, Any]) -> None:
        """Fills ``gradients`` from dL/d(rgb, alpha).

        ``image`` holds the drawn ``rgb`` and ``alpha`` (the frame does not keep them: as outputs of a torch operation
        they would keep it alive in turn, for ever). ``gradients`` are arrays by name: those of the Gaussians,
        ``screen`` (N, 2), and where wanted ``screen_absolute`` (N, 2) and ``pose`` (3, 4), see Image and rasterize.
        """
        image_gradient = _ImageGradient(_address(rgb), _address(alpha))
        native = _pointers(_Gradients, _GRADIENTS, gradients)
        if library().frog_backward(
            self._handle,
            byref(self._gaussians),
            byref(_pointers(_Image, _IMAGE, image)),
            byref(image_gradient),
            byref(native),
        ):
            raise MemoryError("the rasterizer's backward pass ran out of memory")

    def work(self) -> dict[str, int]:
        """How much was drawn: ``gaussians``, ``instances`` (Gaussian, tile) and blended ``pairs`` (Gaussian, pixel)."""
        counts = (c_int64 * 3)()
        library().frog_count_work(self._handle, byref(counts))
        return dict(zip(("gaussians", "instances", "pairs"), counts, strict=True))

    def __del__(self) -> None:
        if self._handle:
            self._free(self._handle)
            self._handle = None


class Network:
    """A small feed-forward network evaluated by the library: relu(first + shared), then layers over a scratch row.

    Args:
        hidden: length of the first layer's output, a multiple of 16.
        layers: (input offset, output offset, weights (inputs, outputs), bias (outputs,), relu) each; offsets count in
            one scratch row that starts with the hidden layer; outputs are multiples of 16.
        row_length: length of the scratch row; its last ``outputs`` numbers are the result.
    """

    def __init__(
        self, hidden: int, layers: list[tuple[int, int, Any, Any, bool]], row_length: int, outputs: int
    ) -> None:
        self.hidden, self.row_length, self.outputs = hidden, row_length, outputs
        self._arrays = layers  # kept alive
        self._layers = (_Layer * len(layers))(
            *[
                _Layer(source, weights.shape[0], target, weights.shape[1], relu, _address(weights), _address(bias))
                for source, target, weights, bias, relu in layers
            ]
        )

    def evaluate(self, first: Any, shared: Any, result: Any) -> None:
        """``result`` (N, outputs) from ``first`` (N, hidden), kept per Gaussian, and ``shared`` (hidden,)."""
        if library().frog_evaluate_network(
            len(first),
            self.hidden,
            _address(first),
            _address(shared),
            len(self._layers),
            self._layers,
            self.row_length,
            self.outputs,
            _address(result),
        ):
            raise MemoryError("evaluating the deformation network ran out of memory")
