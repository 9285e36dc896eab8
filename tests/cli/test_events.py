"""``frog train --events``: a training that another program follows, and ends by a signal."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.builders import REPOSITORY

from frog_blender.engine.scene.scene_file import read_scene

TRAIN = [sys.executable, "-m", "frog_blender.cli", "train"]
SMALL = ["--recipe", "draft", "--max-gaussians", "250", "--device", "cpu", "--events"]


def followed(*options: object) -> subprocess.Popen[bytes]:
    command = [*TRAIN, *map(str, options), *SMALL]
    return subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


def test_a_whole_training(own_cache: Path, filmed: Path, tmp_path: Path) -> None:
    with followed(filmed, "--out", tmp_path / "x.frog", "--steps", "12") as training:
        said = [json.loads(line) for line in training.communicate(timeout=300)[0].splitlines()]
    assert training.returncode == 0
    assert {"started", "progress", "evaluated", "preview", "saved"} <= {event["event"] for event in said}
    last = said[-1]
    assert (last["event"], last["path"], last["steps"]) == ("finished", str(tmp_path / "x.frog"), 12)
    assert last["phases"] and last["capacity"]["gaussians"] == last["gaussians"]
    assert read_scene(tmp_path / "x.frog").header.steps == 12


@pytest.mark.skipif(sys.platform == "win32", reason="no signal ends a process gently there")
def test_a_signal_ends_it_with_a_scene(own_cache: Path, filmed: Path, tmp_path: Path) -> None:
    with followed(filmed, "--out", tmp_path / "x.frog", "--steps", "100000") as training:
        assert training.stdout is not None
        while json.loads(training.stdout.readline())["event"] != "progress":
            pass
        training.send_signal(signal.SIGTERM)
        last = json.loads(training.communicate(timeout=300)[0].splitlines()[-1])
    assert training.returncode == 3
    assert (last["event"], last["path"]) == ("cancelled", str(tmp_path / "x.frog")) and last["step"] > 0
    assert read_scene(tmp_path / "x.frog").header.steps == last["step"]
