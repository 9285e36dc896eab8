"""A grid on the workers of a Dask cluster: every run once, also when a worker dies."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed")

from frog_blender.engine.distributed.cluster import LOCAL, Cluster
from frog_blender.engine.errors import FrogError
from frog_blender.research.execute import GridCallbacks, Progress, run_grid
from frog_blender.research.grid import Run
from frog_blender.research.results import read
from frog_blender.research.runs import RunEnvironment, Stopped
from frog_blender.research.workers import ClusterWorkers


@pytest.fixture(scope="module")
def cluster(cache_folder: Path) -> Iterator[Cluster]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FROG_CACHE", str(cache_folder))  # workers have the environment of their first moment
        with Cluster(LOCAL, workers=2) as cluster:
            yield cluster


def runs_of(capture: Path, count: int, **changes: Any) -> list[Run]:
    first = Run("tiny", str(capture), "frog", "FRoG", overrides=(("seed_gaussians", 200),), steps=20)
    return [replace(first, seed=seed, **changes) for seed in range(count)]


def psnrs(environment: RunEnvironment) -> dict[int, float]:
    records = read(environment.results)
    assert len({record["key"] for record in records}) == len(records), "a run was recorded twice"
    assert {record["kind"] for record in records} == {"run"}, records
    return {record["seed"]: record["psnr"] for record in records}


def kill_one(cluster: Cluster) -> None:
    processes = cluster._client.run(os.getpid)
    os.kill(min(processes.values()), signal.SIGKILL)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
def test_all_runs_once_though_a_worker_dies(cluster: Cluster, filmed: Path, quick_seeds: None, tmp_path: Path) -> None:
    plain, given = RunEnvironment(tmp_path / "plain", "cpu", threads=1), RunEnvironment(tmp_path / "given", "cpu")
    runs = runs_of(filmed, 8)
    run_grid(runs, plain)  # keeps its seed points where the workers find them
    killed = threading.Event()

    def kill_half_way(progress: Progress) -> None:
        if progress.done >= 3 and progress.shares and not killed.is_set():
            killed.set()
            kill_one(cluster)

    workers = ClusterWorkers(cluster, threads=1)
    assert workers.jobs == 2 and cluster.threads() == max(1, (os.cpu_count() or 1) // 2)
    progress = run_grid(runs, given, workers=workers, callbacks=GridCallbacks(kill_half_way))
    assert killed.is_set() and (progress.done, progress.failed, progress.shares) == (8, 0, {})
    assert psnrs(given) == psnrs(plain)


def test_a_run_that_fails_says_why(cluster: Cluster, tmp_path: Path) -> None:
    environment = RunEnvironment(tmp_path, "cpu")
    assert run_grid(runs_of(tmp_path / "none", 1), environment, workers=ClusterWorkers(cluster, 1)).failed == 1
    (record,) = read(environment.results)
    assert record["kind"] == "failed" and "tiny: there is no such folder" in record["error"]


def test_a_stopped_grid_goes_on(filmed: Path, quick_seeds: None, tmp_path: Path) -> None:
    environment, told = RunEnvironment(tmp_path, "cpu"), threading.Event()
    runs = runs_of(filmed, 1, steps=100_000)

    def started(progress: Progress) -> None:
        if any(progress.shares.values()):
            told.set()

    with Cluster(LOCAL) as cluster:
        workers = ClusterWorkers(cluster, 1)
        with pytest.raises(Stopped):
            run_grid(runs, environment, workers=workers, callbacks=GridCallbacks(started, told.is_set))
    assert not read(environment.results) and list((tmp_path / "scenes").glob("*.frog*"))


def test_no_scheduler_is_told() -> None:
    for address in ("tcp://127.0.0.1:9", "nowhere"):
        with pytest.raises(FrogError, match="no Dask scheduler answered"):
            Cluster(address)
