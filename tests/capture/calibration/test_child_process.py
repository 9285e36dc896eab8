"""A calibrator that crashes, is killed or cancelled leaves the caller as it was."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import pytest

from frog_blender.engine.capture.calibration import child_process
from frog_blender.engine.capture.calibration.child_process import CalibrationCancelled, run, run_several
from frog_blender.engine.errors import FrogError


def requested(folder: Path, request: object) -> Path:
    (folder / "request.json").write_text(json.dumps(request))
    return folder


def test_an_error_in_the_child_is_one_sentence(tmp_path: Path) -> None:
    folder = requested(tmp_path, {"views": [{"key": "0"}], "work": str(tmp_path / "nothing")})
    with pytest.raises(FrogError, match=r"ended with status 1 .*nothing was written"):
        run("standing", folder, lambda *_: None, lambda: False)


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_crash_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "crashes"
    program.write_text(f"#!{sys.executable}\nimport os\nos.kill(os.getpid(), 11)\n")
    program.chmod(0o755)
    monkeypatch.setattr(child_process.sys, "executable", str(program))
    with pytest.raises(FrogError, match=r"ended by signal 11"):
        run("standing", tmp_path, lambda *_: None, lambda: False)


@pytest.mark.skipif(os.name == "nt", reason="scripts")
def test_cancelling_ends_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, started = tmp_path / "waits", tmp_path / "pid"
    program.write_text(
        f"#!{sys.executable}\nimport os, pathlib, time\npathlib.Path({str(started)!r}).write_text(str(os.getpid()))\n"
        'print(\'{"stage": "poses", "done": 1, "all": 2}\', flush=True)\ntime.sleep(600)\n'
    )
    program.chmod(0o755)
    monkeypatch.setattr(child_process.sys, "executable", str(program))
    told: list[tuple[str, int, int]] = []
    with pytest.raises(CalibrationCancelled):
        run("standing", tmp_path, lambda *step: told.append(step), lambda: bool(told))
    assert told == [("poses", 1, 2)]
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)


@pytest.mark.skipif(os.name == "nt", reason="scripts")
def test_an_old_result_is_not_taken_for_a_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "result.json").write_text("{}")
    program = tmp_path / "does_nothing"
    program.write_text("#!/bin/sh\nexit 0\n")
    program.chmod(0o755)
    monkeypatch.setattr(child_process.sys, "executable", str(program))
    with pytest.raises(FrogError, match="said nothing"):
        run("standing", tmp_path, lambda *_: None, lambda: False)


def test_the_child_ends_with_its_parent(tmp_path: Path) -> None:
    """Its standard input closes when the parent is gone, however that ended."""
    import subprocess

    folder = requested(tmp_path, {})
    os.mkfifo(folder / "wait") if hasattr(os, "mkfifo") else pytest.skip("no pipes with names")
    (folder / "request.json").unlink()
    os.mkfifo(folder / "request.json")  # reading it waits for ever
    child = subprocess.Popen(
        [sys.executable, "-m", "frog_blender.engine.capture.calibration.child", "standing", str(folder)],
        stdin=subprocess.PIPE,
    )
    assert child.stdin is not None
    time.sleep(0.5)
    child.stdin.close()
    assert child.wait(60) == 1


@pytest.mark.skipif(os.name == "nt", reason="scripts")
def test_what_one_of_several_fails_at_ends_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "waits_or_fails"
    program.write_text(
        f"#!{sys.executable}\nimport os, pathlib, sys, time\nfolder = pathlib.Path(sys.argv[-1])\n"
        "(folder / 'pid').write_text(str(os.getpid()))\n"
        "if folder.name == 'fails':\n"
        "    while not (folder.parent / 'waits' / 'pid').exists():\n        time.sleep(0.01)\n"
        "    sys.exit('no memory')\n"
        "time.sleep(600)\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(child_process.sys, "executable", str(program))
    folders = [tmp_path / "waits", tmp_path / "fails"]
    for folder in folders:
        folder.mkdir()
    with pytest.raises(FrogError, match="no memory"):
        run_several("features", folders, 2, lambda *_: None, lambda: False)
    with pytest.raises(ProcessLookupError):
        os.kill(int((folders[0] / "pid").read_text()), 0)
