"""Damaged and lying files of other programs: no crash, no hang, no memory, only sentences."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.damaged_inputs import counted

pytest.importorskip("resource")

NEEDS = {
    **dict.fromkeys(("usdc", "usda", "usdz", "foreign usd"), "pxr"),
    "spz": "zstandard",
}
FEW = {
    **dict.fromkeys(("usdc", "usda", "usdz", "foreign usd", "sog"), 40),
    "plys": 100,
    **dict.fromkeys(("spz", "glb", "gltf", "splat", "ksplat", "ply", "edits"), 200),
}
ROOM = 64e6
"""Bytes that drawing what was imported may take, above what undamaged files need."""


def opened(kind: str, folder: Path, count: int, seed: int) -> None:
    if kind in NEEDS:
        pytest.importorskip(NEEDS[kind])
    answer = counted("mutated_imports.py", kind, folder, count, seed)
    assert answer["refused"] and answer["used"], "some damage is harmless, most is not"
    assert answer["peak"] < ROOM


@pytest.mark.parametrize("kind", FEW)
def test_some_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, FEW[kind], 1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FEW)
def test_thousands_of_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, 5000, 2)
