"""The field in numpy: how its outputs lie, and the temporal table."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.field.network import column_outputs, num_heads, num_outputs, output_sizes, temporal_weights
from frog_blender.engine.native import binding

TYPES = Path(binding.__file__).parent / "src" / "deformation" / "types.h"


def test_the_native_library_has_the_same_offsets() -> None:
    text = TYPES.read_text(encoding="utf-8")
    native = {name: int(offset) for name, offset in re.findall(r"\bOUT_(\w+) = (\d+)", text)}
    expected, begin = {}, 0
    names = {"means": "MEANS", "log_scales": "SCALES", "quaternions": "QUATERNIONS", "opacity_logits": "OPACITY"}
    for name, size in output_sizes(1).items():
        expected[names.get(name, "SH")] = begin
        begin += size
    assert native == expected


@pytest.mark.parametrize("deformed_sh", [0, 1, 4, 16])
def test_each_output_reaches_one_column(deformed_sh: int) -> None:
    outputs = range(num_outputs(deformed_sh))
    reached = [index for part in column_outputs(deformed_sh).values() for index in outputs[part]]
    assert sorted(reached) == list(outputs)
    assert num_heads(deformed_sh) == (5 if deformed_sh else 4)


TIMES = (0.0, 1e-9, 0.1, 1 / 3, 0.5, 0.77, 1 - 1e-9, 1.0)


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
