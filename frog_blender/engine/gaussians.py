"""Gaussians as plain arrays: what the rasterizer draws, whoever made them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

import numpy as np

from .arrays import Array

if TYPE_CHECKING:
    import torch

ArrayT = TypeVar("ArrayT", Array, "torch.Tensor")
OtherT = TypeVar("OtherT", Array, "torch.Tensor")

ATTRIBUTES = ("means", "quaternions", "scales", "opacities", "sh")
LOW_PASS = 0.3
"""3DGS's, which other programs draw with."""
WIDEST_LOW_PASS = 100.0

_SH_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}


@dataclass
class GaussianArrays(Generic[ArrayT]):
    """N Gaussians, as numpy arrays (playback) or torch tensors (training).

    The native library wants them float32 and contiguous; ``checked`` makes them so.

    Attributes:
        means: (N, 3) world units.
        quaternions: (N, 4) w, x, y, z; any length but zero.
        scales: (N, 3) standard deviations, world units.
        opacities: (N,) in [0, 1].
        sh: (N, K, 3) spherical harmonics in the 3DGS order, K = 1, 4, 9 or 16; display-referred sRGB minus one half.
        low_pass: variance in pixels squared that drawing adds to every splat's screen covariance; (N,) of each where
            they differ.
    """

    means: ArrayT
    quaternions: ArrayT
    scales: ArrayT
    opacities: ArrayT
    sh: ArrayT
    low_pass: float | ArrayT = field(default=LOW_PASS, kw_only=True)

    @classmethod
    def of(cls, arrays: Mapping[str, ArrayT], low_pass: float | ArrayT = LOW_PASS) -> GaussianArrays[ArrayT]:
        """Of the five arrays by name."""
        return GaussianArrays(*(arrays[name] for name in ATTRIBUTES), low_pass=low_pass)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """0 to 3."""
        return _SH_DEGREES[self.sh.shape[1]]

    @property
    def arrays(self) -> dict[str, ArrayT]:
        """The five arrays by name."""
        return {name: getattr(self, name) for name in ATTRIBUTES}

    def mapped(self, change: Callable[[ArrayT], OtherT]) -> GaussianArrays[OtherT]:
        """With other arrays, each made of its own."""
        low_pass = self.low_pass if isinstance(self.low_pass, int | float) else change(self.low_pass)
        return GaussianArrays(*map(change, self.arrays.values()), low_pass=low_pass)

    def changed(self, arrays: Mapping[str, ArrayT]) -> GaussianArrays[ArrayT]:
        """With some arrays in place of their own."""
        return GaussianArrays.of({**self.arrays, **arrays}, self.low_pass)

    def part(self: NumpyGaussians, rows: Array | slice) -> NumpyGaussians:
        """Those of some rows: indices, a mask or a slice."""
        return self.mapped(lambda array: array[rows])

    def checked(self) -> NumpyGaussians:
        """The same as contiguous float32 numpy arrays; ValueError names an array of the wrong shape."""
        gaussians = self.mapped(lambda array: np.ascontiguousarray(array, dtype=np.float32))
        for name, shape in gaussians._shapes().items():
            array = getattr(gaussians, name)
            if array.shape != shape:
                raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
        return gaussians

    def check_tensors(self, device: torch.device) -> None:
        """ValueError for a tensor of another shape, type or device: native code sees addresses alone."""
        for name, shape in self._shapes().items():
            tensor = getattr(self, name)
            # By name: torch is not imported where Gaussians are played.
            if tensor.shape != shape or str(tensor.dtype) != "torch.float32" or tensor.device != device:
                actual = f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}"
                raise ValueError(f"{name}: {actual}, expected {shape} torch.float32 on {device}")

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """That the arrays ought to have; of degree 0 where there is no such number of coefficients."""
        count, sh = len(self), self.sh
        coefficients = sh.shape[1] if sh.ndim == 3 and sh.shape[1] in _SH_DEGREES else 1
        shapes: dict[str, tuple[int, ...]] = {"means": (count, 3), "quaternions": (count, 4), "scales": (count, 3)}
        shapes |= {} if isinstance(self.low_pass, int | float) else {"low_pass": (count,)}
        return {**shapes, "opacities": (count,), "sh": (count, coefficients, 3)}


NumpyGaussians: TypeAlias = GaussianArrays[Array]
TorchGaussians: TypeAlias = "GaussianArrays[torch.Tensor]"
AnyGaussians: TypeAlias = "GaussianArrays[Array] | GaussianArrays[torch.Tensor]"


def rotation_terms(w: Any, x: Any, y: Any, z: Any) -> list[Any]:  # Any: arrays or tensors
    """The nine numbers of the rotation matrices of unit quaternions, row by row."""
    return [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]


def joined(parts: Sequence[NumpyGaussians]) -> NumpyGaussians:
    """All Gaussians of one or more parts, with the SH coefficients of the highest degree among them."""
    if len(parts) == 1:
        return parts[0]
    most = max(part.sh.shape[1] for part in parts)
    padded = [replace(part, sh=np.pad(part.sh, ((0, 0), (0, most - part.sh.shape[1]), (0, 0)))) for part in parts]
    columns = zip(*(part.arrays.values() for part in padded), strict=True)
    low_pass = np.concatenate([np.full(len(part), part.low_pass, np.float32) for part in parts])
    return GaussianArrays(*map(np.concatenate, columns), low_pass=low_pass)
