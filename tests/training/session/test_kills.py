"""Trainings that are killed (SIGKILL) at random times go on where they were, to the same bits; no file is damaged."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked to be killed")


def killed(filmed: Path, folder: Path, kills: int, steps: int) -> dict[str, dict[str, int]]:
    (folder / "capture").symlink_to(filmed)
    script = Path(__file__).parents[2] / "support" / "killed_trainings.py"
    command = [sys.executable, str(script), str(folder), str(kills), "1", str(steps)]
    environment = {**os.environ, "FROG_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=3000)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_few_kills(filmed: Path, tmp_path: Path) -> None:
    answer = killed(filmed, tmp_path, 3, 100)
    assert answer["training"]["kills"] >= 3 and answer["training"]["resumes"] > 0


@pytest.mark.slow
def test_two_hundred_kills(filmed: Path, tmp_path: Path) -> None:
    answer = killed(filmed, tmp_path, 200, 1500)
    assert answer["training"]["kills"] >= 200 and answer["saving"]["kills"] == 50
    assert answer["saving"]["in the middle of a file"] > 10, "kills came while files were being written"
