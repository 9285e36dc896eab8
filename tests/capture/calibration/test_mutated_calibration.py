"""Damaged and hostile files of a calibration: no crash, no hang, no memory, only sentences that name a path."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("resource")
pytest.importorskip("imageio_ffmpeg")

SMALL = {"boards": 200, "plain boards": 100, "clicked points": 200, "reports": 200, "clocks": 40, "stages": 300}
SMALL |= {"films": 40, "stills": 100}


def opened(kind: str, folder: Path, count: int, seed: int) -> None:
    script = Path(__file__).parents[2] / "support" / "mutated_calibration.py"
    command = [sys.executable, str(script), kind, str(folder), str(count), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    answer = json.loads(done.stdout)
    assert answer["refused"] > 0 and answer["used"] > 0, "some damage is harmless, some is not"
    assert answer["peak"] < 500e6


@pytest.mark.parametrize("kind", SMALL)
def test_some_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, SMALL[kind], 1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SMALL)
def test_thousands_of_damaged_files(kind: str, tmp_path: Path) -> None:
    opened(kind, tmp_path, 10 * SMALL[kind], 2)
