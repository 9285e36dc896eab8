"""Looking up the temporal table (FRoG, section on early fusion; E-D3DGS's two resolutions of one table). No torch.

A table of R rows is resampled to n rows and interpolated at a time. Few rows change slowly (coarse), many can follow
fast motion (fine). Both steps are linear in the table, so that each time is a vector of R weights.
"""

from __future__ import annotations

import functools

import numpy as np

from ..arrays import Array


def interpolated(table: Array, time: float) -> Array:
    """(T,) what a table (R, T) has at a time in [0, 1] (clamped): its first row at 0, its last at 1, linear between."""
    return _between(table, min(max(time, 0.0), 1.0) * (len(table) - 1))


def resampled(table: Array, rows: int) -> Array:
    """(rows, T) a table's values at as many times, evenly from 0 to 1."""
    return np.stack([_between(table, row * (len(table) - 1) / max(rows - 1, 1)) for row in range(rows)])


def _between(table: Array, position: float) -> Array:
    row = min(int(position), max(len(table) - 2, 0))
    share = position - row
    result: Array = table[row] if share == 0.0 else (1.0 - share) * table[row] + share * table[row + 1]
    return result


@functools.lru_cache(maxsize=4096)  # a training returns to a few hundred times in thousands of steps
def temporal_weights(time: float, rows: int, table_rows: int) -> Array:
    """(table_rows,) float32, read-only: the weight of each row at a time, of a table resampled to ``rows``."""
    weights = interpolated(_resampling(rows, table_rows), time).astype(np.float32)
    weights.flags.writeable = False
    return weights


@functools.lru_cache(maxsize=8)
def _resampling(rows: int, table_rows: int) -> Array:
    """(rows, table_rows) the matrix that resamples a table."""
    return resampled(np.eye(table_rows), rows)
