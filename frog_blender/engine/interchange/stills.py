"""Gaussians of other programs' files, with plain sizes and opacities: which can be drawn, and several as one. No
torch."""

import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Bools
from ..errors import FrogError, brief, found_instead
from ..gaussians import NumpyGaussians, joined
from ..io.plain_values import UnfitValue
from ..optional_imports import needed_package
from ..playback.transform import Y_DOWN, transform
from ..spherical_harmonics import SH_DC, sh_terms
from ..srgb import linear_to_srgb

LARGEST = 1e18  # its square is a float32 still
_LARGEST_SIZE = 1e12  # the rasterizer draws none of more
OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""The numbers of a quaternion besides the largest, by which that is."""
_EXPECTED = "Gaussians with finite places, sizes and colours"
AS_THEY_ARE = np.eye(4)
"""(4, 4) from a file's axes to themselves."""
Y_UP = np.linalg.inv(Y_DOWN) @ np.diag([1.0, -1.0, -1.0, 1.0])
"""(4, 4) from axes with y up to those with z up: a turn about the x axis."""
ANTIALIASED = "They were trained with anti-aliasing, which is not drawn here: thin and far ones look too large."
LINEAR = "Their colours were linear and are sRGB now; where they are half transparent, they mix a little differently."
_DIRECTIONS, _TOGETHER = 64, 4096


class Part(NamedTuple):
    """Attributes:
    gaussians: as a file has them.
    matrix: (4, 4) from there to the world.
    notes: sentences about what looks otherwise than in the program that wrote them.
    """

    gaussians: NumpyGaussians
    matrix: Array
    notes: tuple[str, ...] = ()


@contextmanager
def decoding(path: Path, expected: str) -> Iterator[None]:
    """One sentence for whatever is raised where a file's content is taken apart, or made."""
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # numbers that are none are left out afterwards
            yield
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    except ImportError as error:
        raise needed_package(path, error) from error
    except (zipfile.BadZipFile, zlib.error, OSError, LookupError, ValueError, RuntimeError, EOFError) as error:
        raise found_instead(path, f"a damaged or foreign file ({brief(error)})", expected) from error


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
    for gaussians, matrix, _ in parts:
        usable, without = _usable(where, gaussians, keep_rows)
        left_out += without
        try:
            made.append(usable if np.array_equal(matrix, AS_THEY_ARE) else transform(usable, matrix))
        except FrogError as error:
            raise FrogError(f"{where}: {error}") from error
    return joined(made), left_out


def display_referred(gaussians: NumpyGaussians) -> NumpyGaussians:
    """Of linear colours, those whose colours are sRGB: in each direction, as nearly as their harmonics allow."""
    count = gaussians.sh.shape[1]
    z = np.linspace(-1, 1, _DIRECTIONS)
    angle, radius = np.arange(_DIRECTIONS) * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - z * z)
    terms = [np.full(_DIRECTIONS, SH_DC), *sh_terms(count, radius * np.cos(angle), radius * np.sin(angle), z)]
    basis = np.stack(terms, axis=1)
    fit, sh = np.linalg.pinv(basis), np.empty(gaussians.sh.shape, np.float32)
    for begin in range(0, len(sh), _TOGETHER):
        some = slice(begin, begin + _TOGETHER)
        colors = linear_to_srgb(np.maximum(basis @ gaussians.sh[some].astype(np.float64) + 0.5, 0))
        sh[some] = fit @ (colors - 0.5)
    return gaussians.changed({"sh": sh})


def completed(others: Array, largest: Array) -> Array:
    """(N, 4) quaternions of the three numbers (N, 3) besides the largest, and which of the four that is (N,)."""
    turns = np.zeros((len(others), 4))
    np.put_along_axis(turns, OTHERS[largest], others, axis=1)
    turns[np.arange(len(turns)), largest] = np.sqrt(np.maximum(1 - np.square(others).sum(axis=1), 0))
    return turns


def largest_and_others(quaternions: Array) -> tuple[Array, Array]:
    """The other way round, of quaternions of any length: (N,) and (N, 3), turned so that the largest is positive."""
    turns = units(quaternions).astype(np.float64)
    largest = np.abs(turns).argmax(axis=1)
    others = np.take_along_axis(turns, OTHERS[largest], axis=1)
    return largest, np.where(turns[np.arange(len(turns)), largest] < 0, -1.0, 1.0)[:, None] * others


def as_bytes(numbers: Array) -> Array:
    """The nearest of 0 to 255."""
    return np.asarray(np.rint(np.nan_to_num(numbers)).clip(0, 255), np.uint8)


def bounded(array: Array) -> Bools:
    """(N,) where all numbers of a row are finite and not too large."""
    return np.asarray((np.abs(array.reshape(len(array), -1)) <= LARGEST).all(axis=1))


def units(quaternions: Array) -> Array:
    """Of length one; without a turn where they have no direction."""
    exact = quaternions.astype(np.float64)
    exact[~exact.any(axis=1)] = (1.0, 0.0, 0.0, 0.0)
    return np.asarray(exact / np.linalg.norm(exact, axis=1, keepdims=True), np.float32)


def _usable(where: str | Path, gaussians: NumpyGaussians, keep_rows: bool) -> tuple[NumpyGaussians, int]:
    with np.errstate(over="ignore", invalid="ignore"):
        g = gaussians.mapped(lambda array: np.asarray(array).astype(np.float32))
        fits = np.logical_and.reduce([bounded(array) for array in g.arrays.values()])
        fits &= (np.abs(g.scales) <= _LARGEST_SIZE).all(axis=1)
    if not len(fits) or fits.mean() < 0.5:
        raise found_instead(where, f"{(~fits).sum():,} of {len(fits):,} Gaussians that cannot be drawn", _EXPECTED)
    if keep_rows:
        for array in g.arrays.values():
            array[~fits] = 0
    elif not fits.all():
        g = g.part(fits)
    g.scales, g.opacities = np.abs(g.scales), g.opacities.clip(0, 1)
    g.quaternions = units(g.quaternions)
    return g, int((~fits).sum())
