"""Looking up the temporal table (FRoG, section on early fusion; E-D3DGS's two resolutions of one table). No torch.

A table of R rows is resampled to n rows and interpolated at a time: with few rows it moves slowly (coarse), with many
it can follow fast motion (fine). Both are linear in the table, so a time is a vector of R weights.
"""

from __future__ import annotations

import functools

import numpy as np


def temporal_shares(time: float, rows: int, table_rows: int) -> dict[int, float]:
    """What counts at ``time`` of a table when resampled to ``rows`` rows: at most four of its rows, and their weights.

    Both steps are linear with the ends aligned: row 0 is time 0, the last row time 1. Times outside are clamped.
    """
    shares: dict[int, float] = {}
    for row, share in _neighbours(min(max(time, 0.0), 1.0) * (rows - 1), rows):
        for table_row, part in _neighbours(row * (table_rows - 1) / max(rows - 1, 1), table_rows):
            shares[table_row] = shares.get(table_row, 0.0) + share * part
    return shares


@functools.lru_cache(maxsize=4096)  # a training comes back to a few hundred moments in thousands of steps
def temporal_weights(time: float, rows: int, table_rows: int) -> np.ndarray:
    """(table_rows,) float32, read-only: ``temporal_shares`` as a vector."""
    weights = np.zeros(table_rows, np.float32)
    for row, share in temporal_shares(time, rows, table_rows).items():
        weights[row] = share
    weights.flags.writeable = False
    return weights


def _neighbours(position: float, count: int) -> list[tuple[int, float]]:
    low = min(int(position), max(count - 2, 0))
    share = position - low
    return [(low, 1.0 - share)] if share == 0.0 else [(low, 1.0 - share), (low + 1, share)]
