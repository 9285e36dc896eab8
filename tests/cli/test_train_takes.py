"""``frog train --takes``: every capture in a folder, here and on a cluster."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import synthetic_capture as film
from support.scene_files import same_arrays

from frog_blender.cli.main import main
from frog_blender.cli.train_command import is_trained, takes_in
from frog_blender.engine.errors import FrogError
from frog_blender.engine.scene.scene_file import read_scene
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


def test_every_take_is_trained_once(
    takes: Path, quick_seeds: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "scenes"
    command = ["train", str(takes), "--out", str(out), *OPTIONS]
    assert main(command) == 0
    told = capsys.readouterr()
    assert f"{out}: 2 of 2 takes are trained" in told.out and "2 takes, 0 of them trained before" in told.out
    assert "notes" in told.err and "left out" in told.err and "one: " in told.err
    alone = tmp_path / "two.frog"
    assert main(["train", str(takes / "two"), "--out", str(alone), *OPTIONS[1:]]) == 0
    assert same_arrays(read_scene(out / "two.frog"), read_scene(alone))

    changed = (out / "two.frog").stat().st_mtime_ns
    (out / "one.frog").unlink()  # its checkpoint says that it is at the end
    before = checkpoint_path(out / "one.frog").stat().st_mtime_ns
    assert main(command) == 0
    assert "1 of them trained before" in capsys.readouterr().out
    assert (out / "two.frog").stat().st_mtime_ns == changed and is_trained(out / "one.frog")
    assert checkpoint_path(out / "one.frog").stat().st_mtime_ns >= before

    assert main([*command, "--overwrite"]) == 0
    assert (out / "two.frog").stat().st_mtime_ns > changed
    assert "0 of them trained before" in capsys.readouterr().out


def test_a_take_that_fails_keeps_no_other_from_being_trained(
    quick_seeds: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    takes, out = tmp_path / "takes", tmp_path / "scenes"
    film.write_capture(takes / "b", [0, 1, 2, 3])
    broken = film.write_capture(takes / "a", [0, 1, 2, 3])
    for video in broken.glob("*.mp4"):
        video.write_bytes(video.read_bytes()[:500])
    assert main(["train", str(takes), "--out", str(out), *OPTIONS]) == 1
    told = capsys.readouterr()
    assert "1 of 2 takes are trained" in told.out and "frog: a: " in told.err
    assert is_trained(out / "b.frog") and not (out / "a.frog").exists()


def test_a_folder_without_captures_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    with pytest.raises(FrogError, match="no capture in it"):
        takes_in(tmp_path, tmp_path / "scenes")
    with pytest.raises(FrogError, match="could not be read"):
        takes_in(tmp_path / "missing", tmp_path)


def test_events_of_several_trainings_are_refused(
    takes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(takes), "--out", str(tmp_path / "x"), *OPTIONS, "--events"]) == 1
    assert "--events" in capsys.readouterr().err


@pytest.mark.slow
def test_workers_train_the_same_scenes(takes: Path, own_cache: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    here, there = tmp_path / "here", tmp_path / "there"
    assert main(["train", str(takes), "--out", str(here), *OPTIONS]) == 0
    given = ["--scheduler", "local", "--jobs", "2"]
    assert main(["train", str(takes), "--out", str(there), *OPTIONS, *given]) == 0
    assert all(same_arrays(read_scene(here / name), read_scene(there / name)) for name in ("one.frog", "two.frog"))
