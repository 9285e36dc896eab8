"""``frog train --segments``, here, on a cluster, and after it was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support import synthetic_capture as film
from support.builders import REPOSITORY
from support.scene_files import same_arrays

from frog_blender.cli.cluster import opened_cluster
from frog_blender.cli.main import main
from frog_blender.engine.distributed.cluster import Cluster
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.scene.segments import segments_of

OPTIONS = ["--recipe", "draft", "--steps", "40", "--segments", "10", "--max-gaussians", "200", "--device", "cpu"]


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film.write_capture(tmp_path_factory.mktemp("take") / "capture", [abs(5 - f % 10) for f in range(20)])


def test_a_take_is_trained_told_and_not_trained_twice(
    take: Path, own_cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "take.frog"
    command = ["train", str(take), "--out", str(out), *OPTIONS]
    assert main(command) == 0
    told = capsys.readouterr()
    assert "Segment 2 of 2: " in told.err and "Whole take: " in told.err
    assert f"{out}: 2 segments, 120 steps" in told.out
    first = read_scene(out)
    assert len(segments_of(first.header.model)) == 2

    assert main(command) == 1 and "--overwrite" in capsys.readouterr().err
    out.unlink()
    assert main(command) == 0  # joined alone
    assert "Whole take" not in capsys.readouterr().err and same_arrays(read_scene(out), first)
    assert main(["info", str(out)]) == 0
    assert "frames 10 to 19" in capsys.readouterr().out
    assert main(["eval", str(out), str(take)]) == 0
    assert main(["train", str(take), "--out", str(out), *OPTIONS, "--resume", "--seed", "3"]) == 1
    assert "other settings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (["--segments", "10", "--events"], "--events"),
        (["--segments", "10", "--method", "curves"], "--method frog"),
        (["--segments", "10", "--seconds", "5"], "--seconds"),
        (["--segments", "15"], "one segment"),
        (["--segments", "10", "--jobs", "2"], "--scheduler local"),
        (["--scheduler", "local"], "--segments FRAMES"),
    ],
)
def test_what_does_not_go_together(
    take: Path, tmp_path: Path, options: list[str], found: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(take), "--out", str(tmp_path / "x.frog"), *options]) == 1
    assert found in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
def test_a_killed_training_goes_on(take: Path, own_cache: Path, tmp_path: Path) -> None:
    out, options = tmp_path / "killed.frog", ["--save-every", "0.05", *OPTIONS]
    command = [sys.executable, "-m", "frog_blender.cli", "train", str(take), "--out", str(out), *options]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    folder = tmp_path / "killed.frog.segments"
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not (folder / "segment_000.frog.checkpoint").is_file():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not out.exists()
    base = (folder / "base.frog").stat().st_mtime_ns
    assert main(["train", str(take), "--out", str(out), *options]) == 0
    assert (folder / "base.frog").stat().st_mtime_ns == base
    straight = tmp_path / "straight.frog"
    assert main(["train", str(take), "--out", str(straight), *options]) == 0
    assert same_arrays(read_scene(out), read_scene(straight))


@pytest.mark.slow
def test_workers_train_the_same_scene(take: Path, own_cache: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    here, there = tmp_path / "here.frog", tmp_path / "there.frog"
    assert main(["train", str(take), "--out", str(here), *OPTIONS]) == 0
    given = ["--scheduler", "local", "--jobs", "2"]
    assert main(["train", str(take), "--out", str(there), *OPTIONS, *given]) == 0
    assert same_arrays(read_scene(here), read_scene(there))


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
def test_a_dead_workers_segment_is_trained_by_another(
    take: Path, own_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    from frog_blender.cli import cluster_trainings, segments_command

    workers, killed, put = list[int](), list[int](), cluster_trainings._put

    @contextmanager
    def opened(scheduler: str, count: int) -> Iterator[Cluster]:
        with opened_cluster(scheduler, count) as cluster:
            workers.extend(cluster._client.run(os.getpid).values())
            yield cluster

    def kill_at_first_word(heard: object, label: str, message: object) -> None:
        if isinstance(message, float) and message < 1 and not killed:
            killed.append(min(workers))
            os.kill(killed[0], signal.SIGKILL)
        put(heard, label, message)

    monkeypatch.setattr(segments_command, "opened_cluster", opened)
    monkeypatch.setattr(cluster_trainings, "_put", kill_at_first_word)
    out, options = tmp_path / "out.frog", [*OPTIONS, "--steps", "300", "--save-every", "0.5"]
    assert main(["train", str(take), "--out", str(out), *options, "--scheduler", "local", "--jobs", "2"]) == 0
    assert killed and len(segments_of(read_scene(out).header.model)) == 2
