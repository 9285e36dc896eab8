"""``frog train --takes``: every capture in a folder, here and on a cluster; and ``frog render --scheduler``."""

import shutil
from pathlib import Path

import pytest
from support import synthetic_capture as film
from support.builders import Run, scene_file
from support.scene_files import same_arrays

from frog_blender.cli.train_command import is_trained
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.training.session.output_paths import checkpoint_path

OPTIONS = ["--takes", "--recipe", "draft", "--steps", "4", "--max-gaussians", "200", "--device", "cpu"]


@pytest.fixture(scope="module")
def takes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two captures, and a folder that is none."""
    folder = tmp_path_factory.mktemp("takes")
    film.write_capture(folder / "one", [0, 1, 2, 3])
    film.write_capture(folder / "two", [3, 2, 1, 0])
    (folder / "notes").mkdir()
    (folder / "notes" / "read.txt").write_text("nothing")
    return folder


def test_every_take_is_trained_once(run: Run, takes: Path, quick_seeds: None, tmp_path: Path) -> None:
    out = tmp_path / "scenes"
    command = ["train", takes, "--out", out, *OPTIONS]
    status, told, err = run(*command)
    assert status == 0 and f"{out}: 2 of 2 takes are trained" in told and "2 takes, 0 of them trained before" in told
    assert "notes" in err and "left out" in err and "one: " in err
    alone = tmp_path / "two.frog"
    assert run("train", takes / "two", "--out", alone, *OPTIONS[1:])[0] == 0
    assert same_arrays(read_scene(out / "two.frog"), read_scene(alone))

    changed = (out / "two.frog").stat().st_mtime_ns
    (out / "one.frog").unlink()  # its checkpoint says that it is at the end
    before = checkpoint_path(out / "one.frog").stat().st_mtime_ns
    assert "1 of them trained before" in run(*command)[1]
    assert (out / "two.frog").stat().st_mtime_ns == changed and is_trained(out / "one.frog")
    assert checkpoint_path(out / "one.frog").stat().st_mtime_ns >= before

    assert "0 of them trained before" in run(*command, "--overwrite")[1]
    assert (out / "two.frog").stat().st_mtime_ns > changed

    shutil.copytree(takes, tmp_path / "copied")  # with other times of files, elsewhere
    assert run("train", tmp_path / "copied", "--out", out, *OPTIONS)[0] == 0
    (tmp_path / "tuesday").mkdir()
    (tmp_path / "tuesday" / "one").symlink_to(takes / "two")
    before = {path: path.read_bytes() for path in out.iterdir()}
    for folder, more, word in (
        (tmp_path / "tuesday", [], "found a training with other images; --overwrite trains it anew, another --out"),
        (takes, ["--recipe", "standard"], "recipe draft where standard is asked for"),
        (takes, ["--scale", "0.5"], "scale None where 0.5 is asked for"),
        (takes, ["--steps", "5"], "steps 4 where 5 is asked for"),
        (takes, ["--set", "sh_degree=0"], "sh_degree 1 where 0 is asked for"),
    ):
        status, told, err = run("train", folder, "--out", out, *OPTIONS, *more)
        assert status == 1 and "0 of them trained before" in told and word in err
    checkpoint_path(out / "one.frog").unlink()
    assert "recipe draft where standard" in run(*command, "--recipe", "standard")[2]
    assert before.items() >= {path: path.read_bytes() for path in out.iterdir()}.items()


def test_a_take_that_fails_keeps_no_other_from_being_trained(run: Run, quick_seeds: None, tmp_path: Path) -> None:
    takes, out = tmp_path / "takes", tmp_path / "scenes"
    film.write_capture(takes / "b", [0, 1, 2, 3])
    broken = film.write_capture(takes / "a", [0, 1, 2, 3])
    for video in broken.glob("*.mp4"):
        video.write_bytes(video.read_bytes()[:500])
    status, told, err = run("train", takes, "--out", out, *OPTIONS)
    assert status == 1 and "1 of 2 takes are trained" in told and "frog: a: " in err
    assert is_trained(out / "b.frog") and not (out / "a.frog").exists()


@pytest.mark.slow
def test_workers_train_the_same_scenes(run: Run, takes: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    here, there = tmp_path / "here", tmp_path / "there"
    assert run("train", takes, "--out", here, *OPTIONS)[0] == 0
    assert run("train", takes, "--out", there, *OPTIONS, "--scheduler", "local", "--jobs", 2)[0] == 0
    assert all(same_arrays(read_scene(here / name), read_scene(there / name)) for name in ("one.frog", "two.frog"))


def test_frames_are_those_of_one_process(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
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
    assert status == 2 and "has no camera 'nobody'" in err and "Dask" not in err, "before any part is given away"
    (tmp_path / "file").write_text("")
    status, _, err = run("render", scene, "--camera", "odd", "--out", tmp_path / "file", "--scheduler", "local")
    assert status == 1 and "could not be made" in err, "of a part that failed"
