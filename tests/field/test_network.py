"""The field in numpy: how its outputs lie, and the temporal table."""

import re
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.field.network import column_outputs, num_outputs, output_sizes, temporal_weights
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
    assert len(output_sizes(deformed_sh)) == (5 if deformed_sh else 4)


@pytest.mark.parametrize(("rows", "table_rows"), [(1, 1), (2, 2), (9, 9), (4, 11), (2, 20), (5, 20)])
def test_a_table_is_resampled_and_then_interpolated(rows: int, table_rows: int) -> None:
    """All its rows mean interpolation alone; times outside are held."""
    table = np.random.default_rng(0).normal(size=(table_rows, 4))
    nodes = np.linspace(0, table_rows - 1, rows)
    columns = [np.interp(nodes, np.arange(table_rows), column) for column in table.T]
    for time in (-3.0, 0.0, 1e-9, 0.1, 1 / 3, 0.5, 0.77, 1 - 1e-9, 1.0, 1.5):
        expected = [np.interp(time * (rows - 1), np.arange(rows), column) for column in columns]
        np.testing.assert_allclose(temporal_weights(time, rows, table_rows) @ table, expected, atol=1e-6)
