"""Gaussians of other programs' files, with plain sizes and opacities: which can be drawn, and several as one. No
torch."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..arrays import Array, Bools
from ..errors import FrogError, found_instead
from ..gaussians import GaussianArrays, NumpyGaussians, joined
from ..playback.transform import Y_DOWN, transform

LARGEST = 1e18  # its square is a float32 still
_LARGEST_SIZE = 1e12  # the rasterizer draws none of more
_EXPECTED = "Gaussians with finite places, sizes and colours"
AS_THEY_ARE = np.eye(4)
"""(4, 4) from a file's axes to themselves."""
Y_UP = np.linalg.inv(Y_DOWN) @ np.diag([1.0, -1.0, -1.0, 1.0])
"""(4, 4) from axes with y up to those with z up: a turn about the x axis."""
Part = tuple[NumpyGaussians, Array]
"""Gaussians as a file has them, and (4, 4) from there to the world."""


def gathered(where: str | Path, parts: Iterable[Part], *, keep_rows: bool = False) -> tuple[NumpyGaussians, int]:
    """Those of one or more parts that can be drawn, as one: unit quaternions, opacities in [0, 1], sizes from 0 on; and
    how many cannot be drawn.

    Args:
        where: for the sentence.
        keep_rows: those that cannot be drawn stay where they are, without a size or opacity; else they are taken out.

    Raises:
        FrogError: where most of a part cannot be drawn, or could not follow its matrix.
    """
    made, left_out = [], 0
    for gaussians, matrix in parts:
        usable, without = _usable(where, gaussians, keep_rows)
        left_out += without
        try:
            made.append(usable if np.array_equal(matrix, AS_THEY_ARE) else transform(usable, matrix))
        except FrogError as error:
            raise FrogError(f"{where}: {error}") from error
    return joined(made), left_out


def bounded(array: Array) -> Bools:
    """(N,) where all numbers of a row are finite and not too large."""
    result: Bools = (np.abs(array.reshape(len(array), -1)) <= LARGEST).all(axis=1)
    return result


def units(quaternions: Array) -> Array:
    """Of length one; without a turn where they have no direction."""
    exact = quaternions.astype(np.float64)
    exact[~exact.any(axis=1)] = (1.0, 0.0, 0.0, 0.0)
    result: Array = (exact / np.linalg.norm(exact, axis=1, keepdims=True)).astype(np.float32)
    return result


def _usable(where: str | Path, gaussians: NumpyGaussians, keep_rows: bool) -> tuple[NumpyGaussians, int]:
    with np.errstate(over="ignore", invalid="ignore"):
        arrays = {name: np.asarray(array).astype(np.float32) for name, array in vars(gaussians).items()}
        fits = np.logical_and.reduce([bounded(array) for array in arrays.values()])
        fits &= (np.abs(arrays["scales"]) <= _LARGEST_SIZE).all(axis=1)
    if not len(fits) or fits.mean() < 0.5:
        raise found_instead(where, f"{(~fits).sum():,} of {len(fits):,} Gaussians that cannot be drawn", _EXPECTED)
    if not fits.all():
        for name, array in arrays.items():
            if keep_rows:
                array[~fits] = 0
            else:
                arrays[name] = array[fits]
    g = GaussianArrays(**arrays)
    g.scales, g.opacities = np.abs(g.scales), g.opacities.clip(0, 1)
    g.quaternions = units(g.quaternions)
    return g, int((~fits).sum())
