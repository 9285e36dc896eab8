"""Damaged and hostile files of every layout: no crash, no hang, no memory, only sentences that name a path."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.damaged_inputs import counted
from support.mutated_captures import LAYOUTS

pytest.importorskip("resource")


GROUPS = [",".join(list(LAYOUTS)[start::3]) for start in range(3)]


def opened(layouts: str, folder: Path, count: int, seed: int) -> None:
    answers = counted("mutated_captures.py", layouts, folder, count, seed).values()
    refused, used = (sum(answer[what] for answer in answers) for what in ("refused", "used"))
    assert refused > used > 0, "some damage is harmless, most is not"
    assert max(answer["peak"] for answer in answers) < 500e6


@pytest.mark.parametrize("layouts", GROUPS)
def test_some_damaged_captures(layouts: str, tmp_path: Path) -> None:
    opened(layouts, tmp_path, 40, 1)


@pytest.mark.slow
@pytest.mark.parametrize("layouts", GROUPS)
def test_thousands_of_damaged_captures(layouts: str, tmp_path: Path) -> None:
    opened(layouts, tmp_path, 1250, 2)
