"""Weights of the temporal table: what they sum to, where they end, and what resampling means."""

from __future__ import annotations

import math

import numpy as np
import pytest

from frog_blender.engine.field.network import temporal_weights

TIMES = (0.0, 1e-9, 0.1, 1 / 3, 0.5, 0.77, 1 - 1e-9, 1.0)


@pytest.mark.parametrize("rows", [1, 2, 3, 7, 20])
@pytest.mark.parametrize("time", TIMES)
def test_weights_are_a_partition_of_unity(rows: int, time: float) -> None:
    weights = temporal_weights(time, rows, 20)
    assert weights.shape == (20,) and weights.dtype == np.float32
    assert (weights >= 0).all()
    assert math.isclose(weights.sum(), 1, abs_tol=1e-6)
    assert np.count_nonzero(weights) <= 4


@pytest.mark.parametrize("rows", [2, 5, 20])
def test_ends_are_the_first_and_last_row(rows: int) -> None:
    first, last = np.eye(20)[[0, -1]]
    for time, expected in ((0.0, first), (-3.0, first), (1.0, last), (1.5, last)):
        np.testing.assert_allclose(temporal_weights(time, rows, 20), expected, atol=1e-6)


@pytest.mark.parametrize("table_rows", [1, 2, 9])
def test_all_rows_mean_plain_interpolation(table_rows: int) -> None:
    table = np.random.default_rng(0).normal(size=(table_rows, 4))
    for time in TIMES:
        position = time * (table_rows - 1)
        expected = [np.interp(position, np.arange(table_rows), column) for column in table.T]
        np.testing.assert_allclose(temporal_weights(time, table_rows, table_rows) @ table, expected, atol=1e-6)


def test_few_rows_mean_resampling_and_then_interpolation() -> None:
    table = np.random.default_rng(1).normal(size=(11, 3))
    nodes = np.linspace(0, 10, 4)
    for time in TIMES:
        expected = [np.interp(time * 3, np.arange(4), np.interp(nodes, np.arange(11), column)) for column in table.T]
        np.testing.assert_allclose(temporal_weights(time, 4, 11) @ table, expected, atol=1e-6)


def test_a_linear_table_is_reproduced_by_any_number_of_rows() -> None:
    table = np.linspace(-2, 5, 13)
    for rows in (2, 3, 5, 13):
        for time in TIMES:
            assert math.isclose(temporal_weights(time, rows, 13) @ table, -2 + 7 * time, abs_tol=1e-5)


def test_weights_are_continuous_in_time() -> None:
    times = np.linspace(0, 1, 2001)
    weights = np.array([temporal_weights(time, 7, 20) for time in times])
    # Seven rows: a weight goes from 0 to 1 in a sixth of the time at the fastest.
    assert np.abs(np.diff(weights, axis=0)).max() <= 6 / 2000 + 1e-6
