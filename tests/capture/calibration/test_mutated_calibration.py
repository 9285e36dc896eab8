"""Damaged and hostile files of a calibration: no crash, no hang, no memory, only sentences that name a path."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.damaged_inputs import counted

pytest.importorskip("resource")
pytest.importorskip("av")

SMALL = {"boards": 200, "plain boards": 100, "clicked points": 200, "reports": 200, "clocks": 40, "stages": 300}
SMALL |= {"films": 40, "stills": 100}


def opened(kind: str, folder: Path, count: int, seed: int) -> None:
    answer = counted("mutated_calibration.py", kind, folder, count, seed)
    assert answer["refused"] > 0 and answer["used"] > 0, "some damage is harmless, some is not"
    assert answer["peak"] < 500e6


@pytest.mark.parametrize("kind", SMALL)
def test_some_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, SMALL[kind], 1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SMALL)
def test_thousands_of_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, 10 * SMALL[kind], 2)
