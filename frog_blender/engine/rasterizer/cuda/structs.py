"""The structs of ``src/shared/types.h`` that kernels take by value, with ctypes.

A test compares every offset and size with what a C++ compiler says.
"""

from __future__ import annotations

from ctypes import Structure, c_float, c_int32, c_void_p
from typing import Any

SPLAT_FLOATS = 16  # a Splat takes 64 bytes
ATTRIBUTES = ("means", "quaternions", "scales", "opacities", "sh")


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
        ("compensate", c_int32),
        ("region", c_int32 * 4),
        ("depth_limit", c_void_p),
    ]


class Gradients(Structure):
    """``FrogGradients``: addresses of what the backward pass writes; ``screen_absolute`` and ``pose`` may be None."""

    _fields_ = [(name, c_void_p) for name in (*ATTRIBUTES, "screen", "screen_absolute", "pose")]


def camera_struct(camera: Any) -> Camera:
    """From a ``capture.camera.Camera``."""
    k = camera.intrinsics
    rows = (c_float * 12)(*camera.world_to_camera[:3].ravel())
    return Camera(rows, k[0, 0], k[1, 1], k[0, 2], k[1, 2], camera.width, camera.height)
