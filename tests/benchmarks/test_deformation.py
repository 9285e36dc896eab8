"""The deformation benchmark: a record for every network and path, with bounds that follow from their sizes."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from support.builders import REPOSITORY

PATHS = ("training, forward", "training, forward and backward", "inference")


@pytest.mark.parametrize(
    "caches", [["--cold"], pytest.param([], marks=pytest.mark.slow), pytest.param(["--apart"], marks=pytest.mark.slow)]
)
def test_records_of_all_networks_and_paths(caches: list[str]) -> None:
    command = [sys.executable, str(REPOSITORY / "benchmarks" / "deformation.py")]
    command += ["--counts", "300", "--threads", "1", "--repeats", "1", *caches]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    records = [json.loads(line) for line in done.stdout.splitlines()]
    found = {(record["network"], record["networks"], record["path"]): record for record in records}
    networks = ("shared 64", "shared 64, modulated", "five heads of 128")
    assert set(found) == {(name, count, path) for name in networks for count in (1, 2) for path in PATHS}
    for (name, count, path), record in found.items():
        assert record["count"] == 300 and record["threads"] == 1
        assert [f"--{name}" for name in ("cold", "apart") if record[name]] == caches
        assert record["seconds"] >= record["best"] > 0 and record["memory_bound"] > 0
        # 300 Gaussians, 2 operations a multiply-add: embeddings of 32, and 14 outputs or 23 behind heads of 128.
        forward = (32 * 64, 14 * 64) if name.startswith("shared") else (32 * 128 + 640 * 128, 23 * 128)
        kept = path == "inference" and name == "shared 64"
        products = (sum(forward) - kept * forward[0]) * (3 if "backward" in path else 1)
        assert abs(record["gflop"] - count * 2 * 300 * products / 1e9) < 1e-6
