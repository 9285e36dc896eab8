"""The playback benchmark: a record for each scene, and one sentence where there is nothing to be timed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from support.builders import run_benchmark, scene_file

from frog_blender.engine.field.names import CANONICAL
from frog_blender.engine.scene.scene_file import SceneFile, write_scene


def test_a_record_for_each_scene(tmp_path: Path) -> None:
    write_scene(tmp_path / "all.frog", scene_file(200))
    write_scene(tmp_path / "some.frog", scene_file(200, moving=30, hidden_width=16))
    done = run_benchmark("playback.py", tmp_path / "all.frog", tmp_path / "some.frog", "--repeats", 3)
    assert done.returncode == 0, done.stderr
    first, second = (json.loads(line) for line in done.stdout.splitlines())
    assert (first["scene"], first["gaussians"], first["moving"], first["units"]) == ("all.frog", 200, 200, 24)
    assert (second["scene"], second["gaussians"], second["moving"], second["units"]) == ("some.frog", 200, 30, 16)
    assert first["first over this"] == 1.0 and first["milliseconds"] > 0 and second["first over this"] > 0


def test_a_scene_in_which_nothing_moves_is_refused(tmp_path: Path) -> None:
    scene = scene_file(20)
    still = {name: array for name, array in scene.arrays.items() if name in CANONICAL}
    write_scene(tmp_path / "still.frog", SceneFile(replace(scene.header, model={}), still))
    done = run_benchmark("playback.py", tmp_path / "still.frog")
    assert done.returncode == 2 and done.stdout == "" and "still.frog: nothing moves there" in done.stderr
