"""Whether the numbers of a ``.ply`` can be splats; a table whose numbers mean something else is refused. No torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..arrays import Array, SceneArrays
from ..errors import found_instead

_EXPECTED = "logarithms of sizes, logits of opacities and the like, as 3DGS trainings write them"
_LARGEST = 1e18  # its square is a float32 still
_LARGEST_SIZE = 27.0  # a logarithm: the rasterizer draws none of 1e12 or more
_USUAL_SIZE = 20.0  # more, and the numbers are no logarithms
_THINNEST = -30.0  # logarithm that stands for that of a size of zero, which some programs write for flat Gaussians
_MOST_CERTAIN = 30.0  # logit that stands for an infinite one, which some programs write for an opacity of one


def floats(path: str | Path, column: Array) -> Array:
    """(N,) float32 of a property: of floats, or of whole numbers of 16 bits, in which some programs write half floats
    because PLY has no name for them. FrogError for other whole numbers."""
    if column.dtype.kind != "f":
        if column.dtype.itemsize != 2:
            raise found_instead(path, f"whole numbers of {8 * column.dtype.itemsize} bits", f"floats, {_EXPECTED}")
        column = column.view(column.dtype.str.translate(str.maketrans("iu", "ff")))
    return column.astype(np.float32)


def cleaned(path: str | Path, arrays: SceneArrays, *, halves: bool) -> tuple[SceneArrays, int]:
    """Arrays with unit quaternions and bounded logits, and how many rows are left out, whose numbers are not finite or
    too large to be drawn. FrogError if most of the table cannot be splats.

    Args:
        arrays: ``means`` (N, 3), ``quaternions`` (N, 4), ``log_scales`` (N, 3), ``opacity_logits`` (N,) and ``sh``
            (N, ...), float32; changed in place.
        halves: whether numbers were read as half floats from whole numbers.
    """
    logits, scales = arrays["opacity_logits"], arrays["log_scales"]
    scales[np.isneginf(scales)] = _THINNEST
    endless = np.isinf(logits)
    logits[endless] = np.copysign(_MOST_CERTAIN, logits[endless])
    fits = np.logical_and.reduce([_bounded(array) for array in arrays.values()]) & (scales <= _LARGEST_SIZE).all(axis=1)
    if complaint := _complaint(arrays, fits):
        made = "whole numbers of 16 bits that are no half floats: " if halves else ""
        raise found_instead(path, made + complaint, _EXPECTED)
    kept = arrays if fits.all() else {name: array[fits] for name, array in arrays.items()}
    kept["opacity_logits"] = kept["opacity_logits"].clip(-_MOST_CERTAIN, _MOST_CERTAIN)
    kept["quaternions"] = _units(kept["quaternions"])
    return kept, int((~fits).sum())


def _bounded(array: Array) -> Array:
    """(N,) where all numbers of a row are finite and not too large."""
    result: Array = (np.abs(array.reshape(len(array), -1)) <= _LARGEST).all(axis=1)
    return result


def _complaint(arrays: SceneArrays, fits: Array) -> str:
    """What shows that most rows are no splats; "" where nothing does."""
    size, logit = _median(arrays["log_scales"]), _median(np.abs(arrays["opacity_logits"]))
    if size > _USUAL_SIZE:
        return f"sizes of e to the {size:,.0f} for half of the Gaussians"
    if logit > 1000:
        return f"opacities with logits of {logit:,.0f} for half of the Gaussians"
    if not fits.any():
        return "not one Gaussian of finite numbers"
    if fits.mean() < 0.5:
        return f"{(~fits).sum():,} of {len(fits):,} Gaussians with numbers that are not finite or too large"
    length = _median(np.linalg.norm(arrays["quaternions"][fits].astype(np.float64), axis=1))
    if length > 200 or (length == 0 and len(fits) > 1):
        return f"quaternions of length {length:,.0f} for half of the Gaussians"
    color = _median(np.abs(arrays["sh"][fits].reshape(fits.sum(), -1)[:, :3]))
    return f"colours of {color:,.0f} for half of the Gaussians" if color > 100 else ""


def _median(numbers: Array) -> float:
    """Of the finite ones; 0 where there are none."""
    finite = numbers[np.isfinite(numbers)]
    return float(np.median(finite)) if finite.size else 0.0


def _units(quaternions: Array) -> Array:
    """Of length one; without a turn where they have no direction."""
    exact = quaternions.astype(np.float64)
    exact[~exact.any(axis=1)] = (1.0, 0.0, 0.0, 0.0)
    result: Array = (exact / np.linalg.norm(exact, axis=1, keepdims=True)).astype(np.float32)
    return result
