"""Whatever ends or kills a training, what it learned is there: closed terminals, schedulers, full disks, SIGKILL."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.system_faults import can_mount

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked to be ended")
ENDING = Path(__file__).parents[2] / "support" / "ended_trainings.py"
ON_A_SMALL_DISK = 'mount -t tmpfs -o size=264m tmpfs "$1" && shift && exec "$@"'


def ended(filmed: Path, folder: Path, how: str, moments: int) -> dict[str, int]:
    (folder / "capture").symlink_to(filmed)
    command = [sys.executable, str(ENDING), str(folder), how, str(moments), "3"]
    cache, temporary = folder / "cache", {}
    if how == "full":
        disk = folder / "disk"
        disk.mkdir()
        command = ["unshare", "-rm", "sh", "-c", ON_A_SMALL_DISK, "sh", str(disk), *command]
        cache, temporary = disk / "cache", {"TMPDIR": str(disk / "tmp")}
    environment = {**os.environ, "FROG_CACHE": str(cache), "OMP_NUM_THREADS": "1", **temporary}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_who_asks_a_training_to_end_gets_its_scene(filmed: Path, tmp_path: Path) -> None:
    assert ended(filmed, tmp_path, "TERM,HUP,INT", 3)["ended"] == 3


@pytest.mark.skipif(not can_mount(), reason="this system does not let its users mount a small file system")
def test_the_one_disk_that_fills_up_costs_no_scene(filmed: Path, tmp_path: Path) -> None:
    assert ended(filmed, tmp_path, "full", 2) == {"cancelled": 1, "finished": 1, "elsewhere": 0}


def killed(filmed: Path, folder: Path, kills: int, steps: int) -> dict[str, int]:
    (folder / "capture").symlink_to(filmed)
    script = Path(__file__).parents[2] / "support" / "killed_trainings.py"
    command = [sys.executable, str(script), str(folder), str(kills), "1", str(steps)]
    environment = {**os.environ, "FROG_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=3000)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_few_kills(filmed: Path, tmp_path: Path) -> None:
    answer = killed(filmed, tmp_path, 3, 100)
    assert answer["kills"] >= 3 and answer["resumes"] > 0


@pytest.mark.slow
def test_two_hundred_kills(filmed: Path, tmp_path: Path) -> None:
    assert killed(filmed, tmp_path, 200, 1500)["kills"] >= 200
