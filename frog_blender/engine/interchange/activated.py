"""Gaussians of other programs' files, with plain sizes and opacities: which can be drawn, and several as one. No
torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..arrays import Array, Bools
from ..errors import found_instead
from ..gaussians import GaussianArrays, NumpyGaussians
from ..playback.frame_delta import normalize

_LARGEST = 1e18  # its square is a float32 still
_LARGEST_SIZE = 1e12  # the rasterizer draws none of more
_EXPECTED = "Gaussians with finite places, sizes and colours"


def usable(path: str | Path, gaussians: NumpyGaussians, *, keep_rows: bool) -> tuple[NumpyGaussians, int]:
    """Gaussians with unit quaternions, opacities in [0, 1] and sizes from 0 on, and how many cannot be drawn.

    Args:
        path: for the sentence.
        keep_rows: those that cannot be drawn stay where they are, without a size or opacity; else they are taken out.

    Raises:
        FrogError: where most of them cannot be drawn.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        arrays = {name: np.asarray(array).astype(np.float32) for name, array in vars(gaussians).items()}
        fits = np.logical_and.reduce([_bounded(array) for array in arrays.values()])
        fits &= (np.abs(arrays["scales"]) <= _LARGEST_SIZE).all(axis=1)
    if not len(fits) or fits.mean() < 0.5:
        raise found_instead(path, f"{(~fits).sum():,} of {len(fits):,} Gaussians that cannot be drawn", _EXPECTED)
    if not fits.all():
        for name, array in arrays.items():
            if keep_rows:
                array[~fits] = 0
            else:
                arrays[name] = array[fits]
    g = GaussianArrays(**arrays)
    g.scales, g.opacities = np.abs(g.scales), g.opacities.clip(0, 1)
    g.quaternions = _units(g.quaternions)
    return g, int((~fits).sum())


def _bounded(array: Array) -> Bools:
    """(N,) where all numbers of a row are finite and not too large."""
    result: Bools = (np.abs(array.reshape(len(array), -1)) <= _LARGEST).all(axis=1)
    return result


def _units(quaternions: Array) -> Array:
    """Of length one; without a turn where they have no direction."""
    exact = quaternions.astype(np.float64)
    exact[~(np.abs(exact).max(axis=1) > 0)] = (1.0, 0.0, 0.0, 0.0)
    return normalize(exact).astype(np.float32)
