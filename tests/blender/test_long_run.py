"""A long session in minutes: trainings one after the other while the timeline is scrubbed leave nothing behind."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.blender_windows import another_blender

ROOT = Path(__file__).resolve().parents[2]
CAPTURE = ROOT / "examples" / "captures" / "room"


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts what /proc says")
def test_nothing_grows(tmp_path):
    """Caches fill in the first trainings. After them memory does not grow by more than one training differs from
    another, open files and data blocks are as many each time, and threads nearly so."""
    pytest.importorskip("torch")
    pytest.importorskip("cv2")
    limits = ("--minutes", 5, "--each", 8, "--scale", 0.25)
    command = another_blender(ROOT / "benchmarks" / "long_run.py", CAPTURE, *limits)
    environment = os.environ | {"FROG_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    samples = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"training"')]
    assert len(samples) >= 6 and all(sample["frames"] > 20 for sample in samples)
    for figure in ("files", "blocks"):
        assert len({sample[figure] for sample in samples[1:]}) == 1, figure
    assert samples[-1]["threads"] <= samples[1]["threads"] + 2  # Blender begins its own when it first needs them
    half = len(samples) // 2
    first, last = (max(s["megabytes"] for s in part) for part in (samples[1 : half + 1], samples[half + 1 :]))
    assert last < first + 60, [sample["megabytes"] for sample in samples]
