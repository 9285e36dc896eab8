"""Damaged and hostile files: no crash, no hang, no memory, only sentences."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("resource")


def opened(folder: Path, count: int, seed: int) -> dict[str, int]:
    script = Path(__file__).with_name("mutating.py")
    command = [sys.executable, str(script), str(folder), str(count), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def check(answer: dict[str, int]) -> None:
    assert answer["refused"] > answer["played"] > 0, "some damage is harmless, most is not"
    assert answer["peak"] < 200e6


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    check(opened(tmp_path, 1000, 1))


@pytest.mark.slow
def test_a_hundred_thousand_damaged_files(tmp_path: Path) -> None:
    check(opened(tmp_path, 100_000, 2))
