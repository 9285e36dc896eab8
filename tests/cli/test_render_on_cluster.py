"""``frog render --scheduler``: the same files as without it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("distributed")

from support.builders import scene_file

from frog_blender.cli.main import main
from frog_blender.engine.scene.scene_file import write_scene


def test_frames_are_those_of_one_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.frog"
    write_scene(scene, scene_file())
    command = ["render", str(scene), "--camera", scene_file().header.cameras[0].name, "--frames", "1:5"]
    assert main([*command, "--out", str(tmp_path / "here")]) == 0
    assert main([*command, "--out", str(tmp_path / "there"), "--scheduler", "local", "--jobs", "2"]) == 0
    assert "http://127.0.0.1" in capsys.readouterr().err, "the address of the scheduler's page"
    here, there = (sorted((tmp_path / name).iterdir()) for name in ("here", "there"))
    assert [path.name for path in here] == [path.name for path in there] and len(here) == 4
    assert [path.read_bytes() for path in here] == [path.read_bytes() for path in there]


def test_a_part_that_fails_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.frog"
    write_scene(scene, scene_file())
    command = ["render", str(scene), "--camera", "nobody", "--out", str(tmp_path / "out")]
    assert main([*command, "--scheduler", "local"]) == 1
    assert "has no camera 'nobody'" in capsys.readouterr().err
