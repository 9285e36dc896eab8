"""What of a frame is not as at all other moments: the numbers that change, of the Gaussians that move.

A frame's columns are ``means`` (N, 3), ``quaternions`` (N, 4), ``scales`` (N, 3), ``base`` (N, 4: the first SH
coefficient and the opacity) and ``sh_1`` ... (N, 3) of each further coefficient, float32 and contiguous.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ..gaussians import GaussianArrays

WIDTHS = {"means": 3, "quaternions": 4, "scales": 3, "base": 4}


def column_names(sh_count: int) -> tuple[str, ...]:
    """Every column of Gaussians with so many SH coefficients, in a fixed order."""
    return (*WIDTHS, *(f"sh_{k}" for k in range(1, sh_count)))


def column_width(name: str) -> int:
    """Numbers a Gaussian has in a column."""
    return WIDTHS.get(name, 3)


@dataclass(frozen=True)
class FrameDelta:
    """The changing columns of the first M Gaussians at one moment; they are not to be written into.

    Attributes:
        columns: (M, width) by name.
    """

    columns: dict[str, np.ndarray]

    @property
    def bytes(self) -> int:
        """How much memory it takes."""
        return sum(column.nbytes for column in self.columns.values())


def column_of(gaussians: GaussianArrays, name: str, count: int | None = None) -> np.ndarray:
    """(count, width) contiguous: a column of the first ``count`` Gaussians, of all for None."""
    if name == "base":
        opacities = gaussians.opacities[:count]
        base = np.empty((len(opacities), 4), np.float32)
        base[:, :3], base[:, 3] = gaussians.sh[:count, 0], opacities
        return base
    if name in WIDTHS:
        return np.ascontiguousarray(getattr(gaussians, name)[:count])
    return np.ascontiguousarray(gaussians.sh[:count, int(name.removeprefix("sh_"))])


def extract_columns(gaussians: GaussianArrays, names: Collection[str], count: int | None = None) -> FrameDelta:
    """Those columns of the first ``count`` Gaussians."""
    return FrameDelta({name: column_of(gaussians, name, count) for name in names})
