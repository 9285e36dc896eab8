"""Whatever ends or kills a training, what it learned is there: closed terminals, schedulers, full disks, SIGKILL."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.system_faults import can_mount

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked to be ended")
SUPPORT = Path(__file__).parents[2] / "support"
ON_A_SMALL_DISK = 'mount -t tmpfs -o size=264m tmpfs "$1" && shift && exec "$@"'


def answer_of(filmed: Path, folder: Path, script: str, *arguments: object, disk: Path | None = None) -> dict[str, int]:
    """What a script of ``support`` says of the trainings that it ended; on a small disk where one is given."""
    (folder / "capture").symlink_to(filmed)
    command = [sys.executable, str(SUPPORT / script), str(folder), *map(str, arguments)]
    environment = {**os.environ, "FROG_CACHE": str((disk or folder) / "cache"), "OMP_NUM_THREADS": "1"}
    if disk:
        disk.mkdir()
        command = ["unshare", "-rm", "sh", "-c", ON_A_SMALL_DISK, "sh", str(disk), *command]
        environment["TMPDIR"] = str(disk / "tmp")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_who_asks_a_training_to_end_gets_its_scene(filmed: Path, tmp_path: Path) -> None:
    assert answer_of(filmed, tmp_path, "ended_trainings.py", "TERM,HUP,INT", 3, 3)["ended"] == 3


@pytest.mark.skipif(not can_mount(), reason="this system does not let its users mount a small file system")
def test_the_one_disk_that_fills_up_costs_no_scene(filmed: Path, tmp_path: Path) -> None:
    answer = answer_of(filmed, tmp_path, "ended_trainings.py", "full", 2, 3, disk=tmp_path / "disk")
    assert answer == {"cancelled": 1, "finished": 1, "elsewhere": 0}


def test_a_few_kills(filmed: Path, tmp_path: Path) -> None:
    answer = answer_of(filmed, tmp_path, "killed_trainings.py", 3, 1, 100)
    assert answer["kills"] >= 3 and answer["resumes"] > 0


@pytest.mark.slow
def test_two_hundred_kills(filmed: Path, tmp_path: Path) -> None:
    assert answer_of(filmed, tmp_path, "killed_trainings.py", 200, 1, 1500)["kills"] >= 200
