"""The field in numpy: how its outputs lie, the temporal table, and what playback asks of the native deformation."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.builders import pairwise
from support.deformation_fields import field_arrays, in_groups, output_arrays

from frog_blender.engine.field.network import column_outputs, num_outputs, output_sizes, temporal_weights
from frog_blender.engine.native import binding
from frog_blender.engine.native.deformation import FieldShape, PlaybackField

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


def play(
    shape: FieldShape, arrays: dict[str, np.ndarray], result: dict[str, np.ndarray], kept: bool | None = None
) -> None:
    """In groups, unless ``kept`` is None."""
    own = arrays if kept is None else in_groups(shape, arrays, kept)
    PlaybackField(shape, own, bool(kept)).deform({}, result)


@pytest.mark.parametrize(
    ("networks", "hidden", "deformed", "count", "form", "kept"),
    pairwise([1, 2], [1, 33, 64], [0, 1, 4, 16], [1, 5, 16, 97, 1000], ["off", "paper", "unit"], [False, True]),
)
def test_groups_give_the_same(networks: int, hidden: int, deformed: int, count: int, form: str, kept: bool) -> None:
    # A sharpness of 10 would make the rounding of the opacity's change ten times larger.
    shape = FieldShape(0, 16, deformed, form, 1.0, 0.7, 0.5, networks)
    arrays = field_arrays(shape, hidden, 7, count)
    expected, found = output_arrays(shape, count), output_arrays(shape, count)
    found["sh"][:] = arrays["sh"]
    play(shape, arrays, expected)
    play(shape, arrays, found, kept)
    for name, values in expected.items():
        assert np.isfinite(values).all()
        # The exponential makes an absolute error of the logarithm, which may be 4, a relative one.
        rtol = 3e-6 if name == "scales" else 1e-6
        np.testing.assert_allclose(found[name], values, rtol=rtol, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("deformed", [0, 1, 4, 9, 16])
def test_nothing_is_written_beyond_the_last_gaussian(deformed: int) -> None:
    shape = FieldShape(0, deformed, deformed, "unit", 10.0, 1.0, 0.5)
    for count in (1, 15, 16, 17, 96, 97):
        arrays, room = field_arrays(shape, 20, 5, count), output_arrays(shape, count + 1)
        play(shape, arrays, {name: array[:count] for name, array in room.items()}, kept=False)
        for name, array in room.items():
            assert np.isfinite(array[:count]).all() and np.isnan(array[count:]).all(), (name, count)


@pytest.mark.parametrize("kept", [False, True])
def test_the_same_bits_on_any_number_of_threads(kept: bool, same_on_threads: Callable[..., None]) -> None:
    shape = FieldShape(0, 9, 4, "unit", 10.0, 1.0, 0.5, 2)
    arrays = field_arrays(shape, 33, 7, 5000, sh_count=9)

    def played() -> list[np.ndarray]:
        result = output_arrays(shape, 5000) | {"sh": arrays["sh"].copy()}
        play(shape, arrays, result, kept)
        return list(result.values())

    same_on_threads(played)
