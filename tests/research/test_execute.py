"""What a chart runs: by names that stay, run by run, here or on a cluster; it goes on where it was stopped."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import synthetic_capture as film
from support.builders import refused

from frog_blender import engine
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.distributed import cluster as clusters
from frog_blender.engine.errors import FrogError
from frog_blender.engine.notices import Notice
from frog_blender.engine.recipes import recipe
from frog_blender.engine.scene.scene_file import read_scene, settings_json
from frog_blender.engine.training.session.events import Event
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.research import execute
from frog_blender.research.execute import Progress, run_grid
from frog_blender.research.grid import ABLATIONS, Run, ablation_variants, chart_grid
from frog_blender.research.results import Record, append, read
from frog_blender.research.runs import RunEnvironment, Stopped, failure, identity, not_done, perform

CAPTURES = {"room": Path("/somewhere/room"), "dim": Path("/somewhere/dim")}
RUN = Run("room", "/somewhere/room", "frog", "FRoG", overrides=(("fusion", "add"),))


def test_a_key_stays_the_same() -> None:
    """Results are committed: a key of today must be found again tomorrow."""
    assert RUN.key == "ccfe9a7d9de7d4a1"
    assert replace(RUN, capture="/elsewhere/room", label="another name", group="fusion").key == RUN.key
    assert Run("room", "/x", "frog", "FRoG", steps=100).key == "55fc63145983a440"
    swapped = (("fusion", "add"), ("sampling", "off"))
    assert replace(RUN, overrides=swapped).key == replace(RUN, overrides=swapped[::-1]).key


def test_what_decides_the_result_decides_the_key() -> None:
    changes = {"scene": "dim", "method": "ed3dgs", "recipe": "standard", "overrides": (("fusion", "concat"),)}
    changes |= {"seed": 1, "steps": 100, "equal_time": True, "scale": 0.5, "holdout_frames": 8, "protocol": "n3dv"}
    changes |= {"condition": "clean"}
    keys = {replace(RUN, **{name: value}).key for name, value in changes.items()}
    assert len(keys | {RUN.key}) == len(changes) + 1


def test_a_grid_is_what_was_asked_for() -> None:
    runs = chart_grid(CAPTURES, seeds=(3, 2), rows=["frog", "frog-auto", "ed3dgs", "static"], equal_time=True)
    assert len({run.key for run in runs}) == len(runs)
    counts = Counter((run.method, run.equal_time) for run in runs)
    assert counts == {
        ("frog", False): 12,
        ("ed3dgs", False): 6,
        ("ed3dgs", True): 6,
        ("static", False): 4,
        ("static", True): 4,
    }
    assert [run.equal_time for run in runs] == sorted(run.equal_time for run in runs)
    equal_steps = [run.seed for run in runs if not run.equal_time]
    assert equal_steps == sorted(equal_steps), "a first seed of everything comes first"
    assert {run.label for run in runs} == {"FRoG", "FRoG auto", "E-D3DGS", "3DGS (static)"}
    assert [run.settings().capacity for run in runs if run.label == "FRoG auto"] == ["auto"] * 6
    assert all(run.capture == str(CAPTURES[run.scene]) for run in runs)


def test_an_ablation_changes_one_thing_at_a_time() -> None:
    base = recipe("draft")
    runs = chart_grid({"room": CAPTURES["room"]}, seeds=(2, 1), rows=["frog"], ablation=ABLATIONS)
    rows = {run.label: run for run in runs if run.group != "methods"}
    assert set(rows) >= {f"fusion: {name}" for name in ("add", "concat", "attention", "coarse", "fine", "dual")}
    assert {"sampling: off", "sampling: inverse", "sampling: mean depth", "opacity: off", "opacity: paper"} <= set(rows)
    assert {"k = 1", "k = 5", "k = 20", "modulation: off", "seeds: at one time", "loss: without squares"} <= set(rows)
    assert {"12,500 Gaussians", "5% move"} <= set(rows)
    for run in rows.values():
        settings = run.settings()
        changed = {name for name in vars(base) if getattr(settings, name) != getattr(base, name)}
        assert len(changed) == (2 if run.group == "capacity" else 1), (run.label, changed)
    assert Counter(run.label for run in runs)["sampling: off"] == 2
    assert len({run.key for run in runs}) == len(runs)


def test_an_ablation_leaves_out_what_the_recipe_does_itself() -> None:
    base = recipe("draft", opacity_reduction="off", sampling="off", fusion="dual", modulation=False)
    variants = ablation_variants(base, ABLATIONS)
    assert list(variants["modulation"]) == ["modulation: on"]
    plain = ablation_variants(recipe("paper-exact"), ABLATIONS)
    assert not plain["seeds"] and not plain["loss"]
    assert list(ablation_variants(recipe("draft", moment_seeds=False), ["seeds"])["seeds"]) == ["seeds: at many times"]
    assert "fusion: dual" not in variants["fusion"] and "fusion: product" in variants["fusion"]
    assert "sampling: off" not in variants["sampling"] and "opacity: off" not in variants["opacity"]
    assert all(changes["opacity_reduction"] == "unit" for changes in variants["k"].values())


def test_more_rows() -> None:
    rows = [("E-D3DGS, own rates", "ed3dgs", {"network_rate": 1e-4})]
    common = Run(overrides=(("network_rate", 1e-2), ("sh_degree", 2)))
    runs = chart_grid(CAPTURES, common, seeds=(3, 2), rows=rows)
    assert len(runs) == 4 and {run.group for run in runs} == {"methods"}
    assert runs[0].plain_recipe().network_rate == 1e-4 and runs[0].plain_recipe().sh_degree == 2
    assert runs[0].settings().fusion == "dual"


def stub_record(run: Run, environment: RunEnvironment, seconds: float | None = None, **changes: Any) -> Record:
    figures = {"train_seconds": 10.0, "wall_seconds": 12.0, "psnr": 30.0, "gaussians": 5, "steps": 100}
    made = {"threads": environment.threads, "dedicated": environment.dedicated, "seconds_limit": seconds}
    return {"kind": "run", **identity(run), "recipe": settings_json(run.settings()), **figures, **made, **changes}


class Performed(list[Run]):
    """Takes the place of ``perform``: keeps the runs that it was asked for and answers with records."""

    fails: Callable[[Run], Exception | None] = staticmethod(lambda run: None)

    def __call__(
        self,
        run: Run,
        environment: RunEnvironment,
        seconds: float | None,
        advanced: Callable[[float], None],
        cancelled: Callable[[], bool],
    ) -> Record:
        if error := self.fails(run):
            raise error
        self.append(run)
        advanced(0.5)
        return stub_record(run, environment, seconds, train_seconds=10.0 + run.seed)


@pytest.fixture
def performed(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> Performed:
    performed = Performed()
    monkeypatch.setattr(execute, "perform", performed)
    return performed


def grid(seeds: int = 2, **changes: Any) -> list[Run]:
    options = {"rows": ["frog", "static"], **changes}
    return chart_grid({"room": Path("/nowhere/room")}, seeds=(seeds, 1), **options)


def test_finished_runs_are_skipped_and_a_cut_off_line_is_done_again(tmp_path: Path, performed: Performed) -> None:
    environment, runs = RunEnvironment(tmp_path), grid()
    run_grid(runs, environment)
    assert performed == runs
    lines = environment.results.read_bytes().splitlines(keepends=True)
    environment.results.write_bytes(b"".join(lines[:-1]) + lines[-1][:40])  # killed while it wrote
    performed.clear()
    progress = run_grid(runs, environment)
    assert performed == runs[-1:] and (progress.done, progress.failed) == (3, 0)
    assert [record["key"] for record in read(environment.results)] == [run.key for run in runs]
    performed.clear()
    run_grid(grid(ablation=("opacity",)), environment)
    assert {run.label for run in performed} == {"opacity: off", "opacity: paper"}, "only what is new"


def test_a_run_of_other_settings_is_not_done(tmp_path: Path) -> None:
    run, environment = grid()[0], RunEnvironment(tmp_path)
    record = stub_record(run, environment)
    fewer = {name: value for name, value in record["recipe"].items() if name != "fusion"}
    for known in (record, {**record, "recipe": {**fewer, "forgotten": 1}}):  # what came or went decides nothing
        assert not not_done([run], [known], environment)
    for other in (failure(run, "no"), {**record, "recipe": {**record["recipe"], "network_rate": 0.5}}):
        assert not_done([run], [other], environment) == [run]


def test_a_run_that_fails_is_written_down_and_the_next_begins(tmp_path: Path, performed: Performed) -> None:
    def fails(run: Run) -> Exception | None:
        if run.seed == 1:
            return FrogError("/nowhere/room/cam03.mp4: found no file.")
        return MemoryError() if run.method == "static" else None

    performed.fails = fails  # type: ignore[method-assign]
    runs, environment = grid(), RunEnvironment(tmp_path)
    progress = run_grid(runs, environment)
    assert (progress.done, progress.failed) == (1, 2)
    failed = [record for record in read(environment.results) if record["kind"] == "failed"]
    assert [record["error"] for record in failed] == ["MemoryError", "room/cam03.mp4: found no file."]
    del performed.fails
    performed.clear()
    assert run_grid(runs, environment).done == 3
    assert len(performed) == 2, "what failed is tried again next time"


def test_runs_at_equal_time_get_frogs_seconds(tmp_path: Path, performed: Performed) -> None:
    environment = RunEnvironment(tmp_path / "all")
    run_grid(grid(equal_time=True, seeds=3), environment)
    timed = [record for record in read(environment.results) if record["equal_time"]]
    assert [(record["method"], record["seconds_limit"]) for record in timed] == [("static", 11.0)]
    alone = [run for run in grid(equal_time=True) if run.equal_time]
    assert run_grid(alone, RunEnvironment(tmp_path / "other")).failed == 1
    assert "FRoG" in read(tmp_path / "other" / "runs.jsonl")[0]["error"]


def test_stopping_leaves_the_rest_for_next_time(tmp_path: Path, performed: Performed) -> None:
    runs, environment = grid(), RunEnvironment(tmp_path)
    with pytest.raises(Stopped):
        run_grid(runs, environment, cancelled=lambda: len(performed) == 2)
    assert performed == runs[:2]
    run_grid(runs, environment)
    assert performed == runs


def test_progress_is_told(tmp_path: Path, performed: Performed) -> None:
    told: list[tuple[int, float]] = []

    def note(progress: Progress) -> None:
        told.append((progress.done, sum(progress.shares.values())))

    run_grid(grid(), RunEnvironment(tmp_path), progressed=note)
    assert told[0] == (0, 0) and (1, 0.5) in told and told[-1] == (3, 0)


def test_two_processes_do_not_work_on_the_same_results(tmp_path: Path, performed: Performed) -> None:
    def begin_another(_: Progress) -> None:
        refused("writes this file", run_grid, grid(), RunEnvironment(tmp_path))

    pytest.importorskip("fcntl")
    assert run_grid(grid(seeds=1), RunEnvironment(tmp_path), progressed=begin_another).done == 2


# With the real training, on the small recorded scene.


def filmed_run(filmed: Path, **changes: Any) -> Run:
    return replace(Run("tiny", str(filmed), "frog", "FRoG", steps=20), **changes)


def test_a_record_says_everything(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    environment, run = RunEnvironment(tmp_path, threads=1), filmed_run(filmed)
    shares: list[float] = []
    record = perform(run, environment, None, shares.append)
    append(environment.results, record)
    for there in (run, replace(run, capture="/nowhere")):  # of one that is gone nothing says that it is another
        assert not not_done([there], read(environment.results), environment)
    assert not_done([run], [{**record, "made_of": {**record["made_of"], "images": "others"}}], environment) == [run]
    assert (record["key"], record["seed"], record["steps"], record["threads"]) == (run.key, 0, 20, 1)
    assert record["recipe"]["fusion"] == "product" and record["recipe"]["name"] == "draft"
    assert record["bytes"] == environment.scene(run).stat().st_size
    assert 8 < record["psnr"] < 60 and 0 < record["ssim"] < 1 and record["psnr_moving"] > 0
    assert record["machine"]["cores"] >= 1 and record["versions"]["torch"] and record["size"] == [48, 36]
    assert set(record["missing"]) == {name for name in ("flip", "lpips", "lpips_vgg") if record[name] is None}
    assert shares[-1] == 1.0 and str(filmed) not in json.dumps(record)


def test_a_killed_training_goes_on_unless_its_settings_changed(
    filmed: Path, tmp_path: Path, quick_seeds: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, environment = filmed_run(filmed, steps=6), RunEnvironment(tmp_path)
    resumed, run_training = list[bool](), engine.run_training

    def watched(job: TrainingJob, cancelled: Callable[[], bool]) -> Iterator[Event]:
        resumed.append(job.resume)
        return run_training(job, cancelled)

    monkeypatch.setattr(engine, "run_training", watched)
    perform(run, environment)  # was killed before its record was on disk
    perform(run, environment)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "checkpoint_settings", lambda path: {})
        perform(run, environment)
    checkpoint_path(environment.scene(run)).write_bytes(b"damaged")
    assert perform(run, environment)["steps"] == 6
    assert resumed == [False, True, False, False]


def test_an_opened_capture_is_trained_on(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    run = filmed_run(filmed, steps=2, condition="poses 0.4 deg")
    record = perform(run, RunEnvironment(tmp_path))
    assert record["split"] == "held-out" and record["frames"] == film.FRAMES
    cameras, clean = read_scene(RunEnvironment(tmp_path).scene(run)).header.cameras, open_capture(filmed).cameras
    assert (cameras[0].world_to_camera == clean[0].world_to_camera).all(), "the held-out camera stays"
    assert (cameras[1].world_to_camera != clean[1].world_to_camera).any()


@pytest.fixture(scope="module")
def cluster(cache_folder: Path) -> Iterator[clusters.Cluster]:
    pytest.importorskip("distributed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FROG_CACHE", str(cache_folder))  # workers have the environment of their first moment
        with clusters.Cluster(clusters.LOCAL, workers=2) as cluster:
            yield cluster


def tiny_runs(filmed: Path, count: int, steps: int) -> list[Run]:
    first = filmed_run(filmed, overrides=(("seed_gaussians", 200),), steps=steps)
    return [replace(first, seed=seed) for seed in range(count)]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
def test_a_cluster_does_all_once_though_a_worker_dies(
    cluster: clusters.Cluster, filmed: Path, quick_seeds: None, tmp_path: Path
) -> None:
    here, there = RunEnvironment(tmp_path / "here", "cpu", threads=1), RunEnvironment(tmp_path / "there", "cpu")
    runs = [*tiny_runs(filmed, 3, 6), filmed_run(tmp_path / "none", scene="none")]
    run_grid(runs[:3], here)  # keeps its seed points where the workers find them
    killed = threading.Event()

    def kill_half_way(progress: Progress) -> None:
        if progress.done >= 1 and progress.shares and not killed.is_set():
            killed.set()
            os.kill(min(cluster._client.run(os.getpid).values()), signal.SIGKILL)

    assert cluster.slots == 2 and cluster.threads() == max(1, (os.cpu_count() or 1) // 2)
    progress = run_grid(runs, there, cluster=cluster, progressed=kill_half_way)
    assert killed.is_set() and (progress.done, progress.failed, progress.shares) == (3, 1, {})
    records, others = read(there.results), read(here.results)
    assert len({record["key"] for record in records}) == len(records), "a run was recorded twice"
    psnrs, expected = ({r["seed"]: r["psnr"] for r in part if r["kind"] == "run"} for part in (records, others))
    assert psnrs == expected and not any(record["dedicated"] for record in records if record["kind"] == "run")
    (failed,) = [record for record in records if record["kind"] == "failed"]
    assert "none: there is no such folder" in failed["error"]


def test_a_stopped_grid_keeps_what_was_learned(
    cluster: clusters.Cluster, filmed: Path, quick_seeds: None, tmp_path: Path
) -> None:
    """Ctrl-C in a terminal reaches the workers as well."""
    environment, told = RunEnvironment(tmp_path, "cpu"), threading.Event()

    def started(progress: Progress) -> None:
        if any(progress.shares.values()) and not told.is_set():
            for process in cluster._client.run(os.getpid).values():
                os.kill(process, signal.SIGINT)
            told.set()

    with pytest.raises(Stopped):
        run_grid(tiny_runs(filmed, 1, 100_000), environment, cluster=cluster, progressed=started, cancelled=told.is_set)
    assert not read(environment.results) and list((tmp_path / "scenes").glob("*.frog*"))


def test_a_local_cluster_answers_only_its_own(cluster: clusters.Cluster) -> None:
    """Not those without its certificate, nor with one of their own; nor does it show pages."""
    from distributed import Security
    from distributed.core import connect

    async def answered(address: str, security: Security) -> None:
        comm = await connect(address, 10, **security.get_connection_args("client"))
        await asyncio.wait_for(comm.read(), 10)

    known = cluster._client.scheduler_info(n_workers=-1)
    for address in (known["address"], *known["workers"]):
        assert address.startswith("tls://127.0.0.1:")
        for scheme, security in (("tcp", Security()), ("tls", Security.temporary())):
            with pytest.raises((OSError, ValueError, MemoryError)):
                asyncio.run(answered(address.replace("tls", scheme), security))
    pages = [known["services"]["dashboard"], *(worker["services"]["dashboard"] for worker in known["workers"].values())]
    for port in pages:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), 5)
    assert len(cluster._client.run(os.getpid)) == 2


@pytest.mark.parametrize(
    ("address", "said"),
    [("tcp://127.0.0.1:9", "no Dask scheduler answered"), ("tls://127.0.0.1:9", "certificates")]
    + [(wrong, "expected tls://HOST:PORT") for wrong in ("nowhere", "tls://x", "tcp://:1", "file:///x", "")],
)
def test_no_scheduler_is_told(address: str, said: str) -> None:
    pytest.importorskip("distributed")
    refused(said, clusters.Cluster, address)


def test_an_open_address_is_told() -> None:
    distributed = pytest.importorskip("distributed")
    others = distributed.LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=None)
    with others, pytest.warns(Notice, match="can run code as you"), clusters.Cluster(others.scheduler_address) as own:
        assert own.slots == 1
