"""The layout of a network's outputs, which Python and C++ each say once."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from frog_blender.engine.field.network import column_outputs, num_heads, num_outputs, output_sizes
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
