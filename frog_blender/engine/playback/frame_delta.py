"""The part of a frame that changes in time: the changing columns of the dynamic Gaussians.

A frame's columns are ``means`` (N, 3), ``quaternions`` (N, 4), ``scales`` (N, 3), ``base`` (N, 4: the first SH
coefficient and the opacity) and ``sh_1`` ... (N, 3) of each further coefficient, float32 and contiguous.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..gaussians import NumpyGaussians

WIDTHS = {"means": 3, "quaternions": 4, "scales": 3, "base": 4}


def column_names(sh_count: int) -> tuple[str, ...]:
    """Every column of Gaussians with so many SH coefficients, in a fixed order."""
    return (*WIDTHS, *(f"sh_{k}" for k in range(1, sh_count)))


def column_width(name: str) -> int:
    """Numbers a Gaussian has in a column."""
    return WIDTHS.get(name, 3)


@dataclass(frozen=True)
class FrameDelta:
    """The changing columns of the M dynamic Gaussians at one time; not to be written to.

    Attributes:
        columns: (M, width) by name.
    """

    columns: dict[str, Array]

    @property
    def bytes(self) -> int:
        """How much memory it takes."""
        return sum(column.nbytes for column in self.columns.values())


def column_of(gaussians: NumpyGaussians, name: str, count: int | None = None) -> Array:
    """(count, width) contiguous: a column of the first ``count`` Gaussians, of all for None."""
    if name == "base":
        opacities = gaussians.opacities[:count]
        base = np.empty((len(opacities), 4), np.float32)
        base[:, :3], base[:, 3] = gaussians.sh[:count, 0], opacities
        return base
    if name in WIDTHS:
        return np.ascontiguousarray(getattr(gaussians, name)[:count])
    return _coefficient(gaussians.sh[:count], int(name.removeprefix("sh_")))


def column_view(gaussians: NumpyGaussians, name: str) -> Array:
    """(N, width) a column to be read once: not a copy, but for ``base``."""
    if name.startswith("sh_"):
        view: Array = gaussians.sh[:, int(name.removeprefix("sh_"))]
        return view
    return column_of(gaussians, name)


def _coefficient(sh: Array, k: int) -> Array:
    """(N, 3) contiguous, of (N, K, 3)."""
    if sh.dtype != np.float32 or not sh.flags.c_contiguous:
        return np.ascontiguousarray(sh[:, k])
    whole = sh.view("V12")[:, :, 0]  # numpy copies one piece of 12 bytes in half the time of three numbers
    return np.ascontiguousarray(whole[:, k]).view(np.float32).reshape(-1, 3)


def extract_columns(gaussians: NumpyGaussians, names: Collection[str], count: int | None = None) -> FrameDelta:
    """Those columns of the first ``count`` Gaussians."""
    return FrameDelta({name: column_of(gaussians, name, count) for name in names})
