"""``frog render --scheduler``: the same files as without it."""

from pathlib import Path

import pytest

pytest.importorskip("distributed")

from support.builders import Run, scene_file

from frog_blender.engine.scene.scene_file import write_scene


def test_frames_are_those_of_one_process(run: Run, tmp_path: Path) -> None:
    scene = tmp_path / "scene.frog"
    write_scene(scene, scene_file())
    command = ["render", scene, "--camera", "odd", "--frames", "1:5"]
    assert run(*command, "--out", tmp_path / "here")[0] == 0
    status, _, err = run(*command, "--out", tmp_path / "there", "--scheduler", "local", "--jobs", 2)
    assert status == 0 and "Dask: 2 at once\n" in err
    here, there = (sorted((tmp_path / name).iterdir()) for name in ("here", "there"))
    assert [path.name for path in here] == [path.name for path in there] and len(here) == 4
    assert [path.read_bytes() for path in here] == [path.read_bytes() for path in there]
    status, _, err = run("render", scene, "--camera", "nobody", "--out", tmp_path / "o", "--scheduler", "local")
    assert status == 1 and "has no camera 'nobody'" in err, "of a part that failed"
