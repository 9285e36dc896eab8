"""A grid is done run by run, goes on where it was stopped, and outlives a run that fails."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from support import synthetic_capture as film

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.research import runs, worker
from frog_blender.research.execute import GridCallbacks, Progress, run_grid, seconds_left
from frog_blender.research.grid import CommonSettings, Run, SeedCounts, chart_grid
from frog_blender.research.results import Record, append, read
from frog_blender.research.runs import RunEnvironment, Stopped, failure, identity, is_done, perform, settings_of
from frog_blender.research.workers import Processes


def stub_record(run: Run, environment: RunEnvironment, seconds: float | None = None, **changes: Any) -> Record:
    figures = {"train_seconds": 10.0, "wall_seconds": 12.0, "psnr": 30.0, "gaussians": 5, "steps": 100}
    made = {"threads": environment.threads, "dedicated": environment.dedicated, "seconds_limit": seconds}
    return {"kind": "run", **identity(run), "recipe": settings_of(run), **figures, **made, **changes}


class Performed(list[Run]):
    """Takes the place of ``perform``: keeps the runs that it was asked for and answers with records."""

    def __call__(
        self,
        run: Run,
        environment: RunEnvironment,
        seconds: float | None,
        advanced: Callable[[float], None],
        cancelled: Callable[[], bool],
    ) -> Record:
        self.append(run)
        advanced(0.5)
        return stub_record(run, environment, seconds, train_seconds=10.0 + run.seed)


@pytest.fixture
def performed() -> Performed:
    return Performed()


def grid(seeds: int = 2, ablation_seeds: int | None = None, **changes: Any) -> list[Run]:
    options = {"methods": ["frog", "static"], **changes}
    counts = SeedCounts(seeds, 1, ablation_seeds)
    return chart_grid({"room": Path("/nowhere/room")}, CommonSettings(), counts, **options)


def test_finished_runs_are_skipped_and_a_cut_off_line_is_done_again(tmp_path: Path, performed: Performed) -> None:
    environment = RunEnvironment(tmp_path)
    wanted = grid()
    run_grid(wanted, environment, callbacks=GridCallbacks(perform=performed))
    assert performed == wanted
    lines = environment.results.read_bytes().splitlines(keepends=True)
    environment.results.write_bytes(b"".join(lines[:-1]) + lines[-1][:40])  # killed while it wrote
    performed.clear()
    progress = run_grid(wanted, environment, callbacks=GridCallbacks(perform=performed))
    assert performed == wanted[-1:] and (progress.done, progress.failed) == (3, 0)
    assert [record["key"] for record in read(environment.results)] == [run.key for run in wanted]
    performed.clear()
    run_grid(wanted, environment, callbacks=GridCallbacks(perform=performed))
    assert performed == []


def test_a_larger_grid_does_only_what_is_new(tmp_path: Path, performed: Performed) -> None:
    callbacks = GridCallbacks(perform=performed)
    run_grid(grid(seeds=1), RunEnvironment(tmp_path), callbacks=callbacks)
    performed.clear()
    run_grid(grid(ablation_seeds=1, ablation=("opacity",)), RunEnvironment(tmp_path), callbacks=callbacks)
    assert {run.label for run in performed} == {"FRoG", "opacity: off", "opacity: paper"}
    assert [run.seed for run in performed if run.label == "FRoG"] == [1]


def test_a_run_of_other_settings_is_not_done(tmp_path: Path) -> None:
    run, environment = grid()[0], RunEnvironment(tmp_path)
    record = stub_record(run, environment)
    assert is_done(run, [record]) and not is_done(run, []) and not is_done(run, [failure(run, "no")])
    older = {**record, "recipe": {**record["recipe"], "network_rate": 0.5}}
    assert not is_done(run, [older]), "the recipe was changed since"
    fewer = {name: value for name, value in record["recipe"].items() if name != "fusion"}
    assert is_done(run, [{**record, "recipe": {**fewer, "forgotten": 1}}]), "settings that came or went decide nothing"


def test_a_run_that_fails_is_written_down_and_the_next_begins(tmp_path: Path, performed: Performed) -> None:
    def sometimes(run: Run, *arguments: Any) -> Record:
        if run.seed == 1:
            raise FrogError("/nowhere/room/cam03.mp4: found no file.")
        if run.method == "static":
            raise MemoryError
        return performed(run, *arguments)

    wanted, environment = grid(), RunEnvironment(tmp_path)
    progress = run_grid(wanted, environment, callbacks=GridCallbacks(perform=sometimes))
    assert (progress.done, progress.failed) == (1, 2)
    failed = [record for record in read(environment.results) if record["kind"] == "failed"]
    assert [record["error"] for record in failed] == ["MemoryError", "room/cam03.mp4: found no file."]
    performed.clear()
    assert run_grid(wanted, environment, callbacks=GridCallbacks(perform=performed)).done == 3
    assert len(performed) == 2, "what failed is tried again next time"


def test_runs_at_equal_time_get_frogs_seconds(tmp_path: Path, performed: Performed) -> None:
    environment = RunEnvironment(tmp_path)
    run_grid(grid(equal_time=True, seeds=3), environment, callbacks=GridCallbacks(perform=performed))
    timed = [record for record in read(environment.results) if record["equal_time"]]
    assert [(record["method"], record["seconds_limit"]) for record in timed] == [("static", 11.0)]
    alone = [run for run in grid(equal_time=True) if run.equal_time]
    (tmp_path / "other").mkdir()
    assert run_grid(alone, RunEnvironment(tmp_path / "other")).failed == 1
    assert "FRoG" in read(tmp_path / "other" / "runs.jsonl")[0]["error"]


def test_stopping_leaves_the_rest_for_next_time(tmp_path: Path, performed: Performed) -> None:
    wanted, environment = grid(), RunEnvironment(tmp_path)
    with pytest.raises(Stopped):
        run_grid(wanted, environment, callbacks=GridCallbacks(cancelled=lambda: len(performed) == 2, perform=performed))
    assert performed == wanted[:2]
    run_grid(wanted, environment, callbacks=GridCallbacks(perform=performed))
    assert performed == wanted


def test_progress_is_told(tmp_path: Path, performed: Performed) -> None:
    told: list[tuple[int, float, float | None]] = []

    def note(progress: Progress) -> None:
        told.append((progress.done, sum(progress.shares.values()), progress.seconds_left))

    run_grid(grid(), RunEnvironment(tmp_path), callbacks=GridCallbacks(note, perform=performed))
    assert told[0] == (0, 0, None) and told[-1] == (3, 0, 0)
    assert (1, 0.5, pytest.approx(18.0)) in told, "half a run and a whole one of twelve seconds"


def test_time_left_looks_at_the_most_similar_runs() -> None:
    wanted = [Run("room", "", "frog", ""), Run("dim", "", "frog", ""), Run("dim", "", "static", "")]
    done = [
        {"kind": "run", "key": "1", "scene": "room", "method": "frog", "wall_seconds": 100.0},
        {"kind": "run", "key": "2", "scene": "fast", "method": "frog", "wall_seconds": 300.0},
    ]
    assert seconds_left([], {}, [], 1) is None
    assert seconds_left(wanted[:1], {}, done, 1) == 100
    assert seconds_left(wanted[:2], {}, done, 1) == 300
    assert seconds_left(wanted, {}, done, 2) == 250
    assert seconds_left([], {wanted[0]: 0.25}, done, 1) == 75


# With the real training, on the small recorded scene.


def filmed_run(filmed: Path, **changes: Any) -> Run:
    return replace(Run("tiny", str(filmed), "frog", "FRoG", steps=20), **changes)


def test_a_record_says_everything(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    environment, run = RunEnvironment(tmp_path, threads=1), filmed_run(filmed)
    shares: list[float] = []
    record = perform(run, environment, None, shares.append)
    append(environment.results, record)
    assert is_done(run, read(environment.results))
    assert (record["key"], record["seed"], record["steps"], record["threads"]) == (run.key, 0, 20, 1)
    assert record["recipe"]["fusion"] == "product" and record["recipe"]["name"] == "draft"
    assert record["bytes"] == environment.scene(run).stat().st_size
    assert 8 < record["psnr"] < 60 and 0 < record["ssim"] < 1 and record["psnr_moving"] > 0
    assert len(record["curve"]) == 10 and record["curve"][-1][1] == 20
    assert record["curve"][-1][2] == pytest.approx(record["psnr"], abs=0.05)
    assert [point[0] for point in record["curve"]] == sorted(point[0] for point in record["curve"])
    assert record["machine"]["cores"] >= 1 and record["versions"]["torch"] and record["size"] == [48, 36]
    assert set(record["missing"]) == {name for name in ("flip", "lpips") if record[name] is None}
    assert shares[-1] == 1.0 and str(filmed) not in json.dumps(record)


def test_a_killed_training_goes_on(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    environment = RunEnvironment(tmp_path, save_every=0.0)  # a checkpoint after every step
    run = filmed_run(filmed, steps=40)
    asked = 0

    def killed() -> bool:
        nonlocal asked
        asked += 1
        if asked == 26:
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        perform(run, environment, cancelled=killed)
    curve = json.loads(Path(f"{environment.scene(run)}.curve").read_text())["curve"]
    record = perform(run, environment)
    assert record["steps"] == 40 and 0 < len(curve) < len(record["curve"])
    assert record["curve"][: len(curve)] == curve, "the curve's beginning was kept, times included"
    assert [point[1] for point in record["curve"]] == [4 * i for i in range(1, 11)]


def test_a_checkpoint_of_other_settings_is_not_used(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    environment, run = RunEnvironment(tmp_path), filmed_run(filmed)
    first = perform(run, environment)
    assert perform(run, environment)["curve"] == first["curve"], "it went on at its end"
    notes = Path(f"{environment.scene(run)}.curve")
    values = json.loads(notes.read_text())
    values["settings"]["recipe"]["network_rate"] = 7.0  # as if the recipe had been changed since
    notes.write_text(json.dumps(values))
    again = perform(run, environment)
    assert again["steps"] == 20 and again["curve"] != first["curve"], "trained anew, at other times of the clock"
    runs.clean_up(run, environment)
    assert sorted(path.name for path in environment.scene(run).parent.iterdir()) == [
        f"{run.key}.frog",
        f"{run.key}.frog.checkpoint",
    ], "the first seed's checkpoint stays for the timings"
    runs.clean_up(replace(run, seed=1), environment)


def test_an_opened_capture_is_trained_on(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    run = filmed_run(filmed, steps=2, condition="poses 0.4 deg")
    record = perform(run, RunEnvironment(tmp_path))
    assert record["split"] == "held-out" and record["frames"] == film.FRAMES
    cameras, clean = read_scene(RunEnvironment(tmp_path).scene(run)).header.cameras, open_capture(filmed).cameras
    assert (cameras[0].world_to_camera == clean[0].world_to_camera).all(), "the held-out camera stays"
    assert (cameras[1].world_to_camera != clean[1].world_to_camera).any()


def test_a_worker_answers_in_lines(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    def ask(run: Run, stopping: threading.Event) -> list[dict]:
        answer = StringIO()
        task = {"run": run.to_json(), "folder": str(tmp_path), "device": "cpu", "threads": 1}
        worker.serve(json.dumps({**task, "dedicated": False, "seconds": None}), answer, stopping)
        return [json.loads(line) for line in answer.getvalue().splitlines()]

    *shares, last = ask(filmed_run(filmed, steps=3), threading.Event())
    assert shares[-1] == {"share": 1.0}
    assert (last["record"]["kind"], last["record"]["dedicated"]) == ("run", False)
    (failed,) = ask(Run("gone", "/nowhere/gone", "frog", "FRoG", steps=3), threading.Event())
    assert failed["record"]["kind"] == "failed" and "/nowhere" not in failed["record"]["error"]
    stopping = threading.Event()
    stopping.set()
    assert ask(filmed_run(filmed, seed=1), stopping) == [{"stopped": True}]


def test_several_processes(tmp_path: Path) -> None:
    """Two runs of a capture that is not there: both are recorded as failed, and nothing hangs."""
    environment = RunEnvironment(tmp_path, "cpu")
    progress = run_grid(grid(seeds=2, methods=["frog"]), environment, workers=Processes(2))
    assert (progress.done, progress.failed) == (0, 2)
    records = read(environment.results)
    assert {record["seed"] for record in records} == {0, 1}
    assert all("room: there is no such folder" in record["error"] for record in records), records
    assert not list((tmp_path / "scenes").glob("*.log"))
