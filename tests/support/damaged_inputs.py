"""Runs a script of this folder that opens damaged inputs, in a process of its own, and reads what it counted."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def counted(script: str, what: str, folder: Path, count: int, seed: int) -> dict[str, Any]:
    """What ``script`` found with so many inputs of a kind: how many were refused and used, and the memory's peak."""
    command = [sys.executable, str(Path(__file__).with_name(script)), what, str(folder), str(count), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer
