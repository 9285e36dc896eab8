"""Damaged and hostile bakes, arrays and checkpoints: no crash, no hang, no memory, only sentences."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.damaged_inputs import counted

pytest.importorskip("resource")

SMALL = {"bakes": 300, "poses": 300, "points": 200, "masks": 300, "seeds": 200, "checkpoints": 40}


def opened(kind: str, folder: Path, count: int, seed: int) -> None:
    answer = counted("mutated_files.py", kind, folder, count, seed)
    assert answer["refused"] > answer["used"] > 0, "some damage is harmless, most is not"
    assert answer["peak"] < 500e6


@pytest.mark.parametrize("kind", SMALL)
def test_some_hundred_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, SMALL[kind], 1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SMALL)
def test_thousands_of_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, 1000 if kind == "checkpoints" else 5000, 2)
