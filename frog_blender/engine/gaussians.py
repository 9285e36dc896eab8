"""Gaussians as plain arrays: what the rasterizer draws, whoever made them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

import numpy as np

from .arrays import Array

if TYPE_CHECKING:
    import torch

ArrayT = TypeVar("ArrayT", Array, "torch.Tensor")

_SH_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}


@dataclass
class GaussianArrays(Generic[ArrayT]):
    """N Gaussians, as numpy arrays (playback) or torch tensors (training).

    The native library wants them float32 and contiguous; ``checked`` makes them so. Construct the class itself, never
    an alias of it: typing would add an attribute to the instance, and ``vars`` of one are its five arrays.

    Attributes:
        means: (N, 3) world units.
        quaternions: (N, 4) w, x, y, z; any length but zero.
        scales: (N, 3) standard deviations, world units.
        opacities: (N,) in [0, 1].
        sh: (N, K, 3) spherical harmonics in the 3DGS order, K = 1, 4, 9 or 16; display-referred sRGB minus one half.
    """

    means: ArrayT
    quaternions: ArrayT
    scales: ArrayT
    opacities: ArrayT
    sh: ArrayT

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """0 to 3."""
        return _SH_DEGREES[self.sh.shape[1]]

    def part(self: NumpyGaussians, rows: Array | slice) -> NumpyGaussians:
        """Those of some rows: indices, a mask or a slice."""
        return GaussianArrays(*(array[rows] for array in vars(self).values()))

    def checked(self) -> NumpyGaussians:
        """The same as contiguous float32 numpy arrays; ValueError names an array of the wrong shape."""
        count = len(self.means)
        shapes = {"means": (count, 3), "quaternions": (count, 4), "scales": (count, 3), "opacities": (count,)}
        arrays = {}
        for name in ("means", "quaternions", "scales", "opacities", "sh"):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            expected = shapes.get(name)
            if expected is not None and array.shape != expected:
                raise ValueError(f"{name}: shape {array.shape}, expected {expected}")
            arrays[name] = array
        sh = arrays["sh"]
        if sh.ndim != 3 or sh.shape[0] != count or sh.shape[1] not in _SH_DEGREES or sh.shape[2] != 3:
            raise ValueError(f"sh: shape {sh.shape}, expected ({count}, 1 | 4 | 9 | 16, 3)")
        return GaussianArrays(**arrays)

    def check_tensors(self, device: torch.device) -> None:
        """ValueError for a tensor of another shape, type or device: native code sees addresses alone."""
        count, sh = len(self), self.sh
        shapes: dict[str, tuple[int, ...]] = {"means": (count, 3), "quaternions": (count, 4), "scales": (count, 3)}
        coefficients = sh.shape[1] if sh.ndim == 3 and sh.shape[1] in _SH_DEGREES else 1
        shapes |= {"opacities": (count,), "sh": (count, coefficients, 3)}
        for name, shape in shapes.items():
            tensor = getattr(self, name)
            # By name: torch is not imported where Gaussians are played.
            if tensor.shape != shape or str(tensor.dtype) != "torch.float32" or tensor.device != device:
                actual = f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}"
                raise ValueError(f"{name}: {actual}, expected {shape} torch.float32 on {device}")


NumpyGaussians: TypeAlias = GaussianArrays[Array]
TorchGaussians: TypeAlias = "GaussianArrays[torch.Tensor]"
AnyGaussians: TypeAlias = "GaussianArrays[Array] | GaussianArrays[torch.Tensor]"


def joined(parts: Sequence[NumpyGaussians]) -> NumpyGaussians:
    """All Gaussians of one or more parts, with the SH coefficients of the highest degree among them."""
    if len(parts) == 1:
        return parts[0]
    most = max(part.sh.shape[1] for part in parts)
    padded = [replace(part, sh=np.pad(part.sh, ((0, 0), (0, most - part.sh.shape[1]), (0, 0)))) for part in parts]
    columns = zip(*(vars(part).values() for part in padded), strict=True)
    return GaussianArrays(*(np.concatenate(arrays) for arrays in columns))
