"""Timing: moments that no player has seen, waiting for the device, and every figure that the tables want."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support import synthetic_capture as film
from support.builders import odd_camera, scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.training.session import run as training_run
from frog_blender.experiments import timing, timing_pass
from frog_blender.experiments.grid import chart_grid
from frog_blender.experiments.results import read
from frog_blender.experiments.runs import Conditions, perform
from frog_blender.experiments.timing import StepTimes, moments, seconds_each, time_playback
from frog_blender.experiments.timing_pass import time_grid, timed_runs


def test_no_moment_comes_twice() -> None:
    times = moments(200)
    assert len({round(time, 6) for time in times}) == 200 and all(0 <= time < 1 for time in times)
    counts = [sum(i / 10 <= time < (i + 1) / 10 for time in times) for i in range(10)]
    assert min(counts) >= 18, "spread evenly"


def test_the_clock_is_read_when_the_device_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    now, queued = [0.0], [0.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])

    def work(moment: float) -> None:
        queued[0] += moment  # comes back at once, as a kernel's launch does

    def synchronize() -> None:
        now[0] += queued[0]
        queued[0] = 0.0

    assert seconds_each(work, [1.0, 2.0, 3.0], synchronize) == [1.0, 2.0, 3.0]


def test_playing_is_timed_at_different_moments(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ScenePlayer(scene_file())
    asked: list[float] = []
    play = scene.at
    monkeypatch.setattr(scene, "at", lambda time: (asked.append(time), play(time))[1])
    found = time_playback(scene, odd_camera(), count=4)
    assert len(asked) == len(set(asked)) == 4 + timing.WARM_UP
    assert found["gaussians"] == 40 and found["size"] == [45, 27]
    assert 0 < found["deformation_ms"] < found["frame_ms"] and found["rasterization_ms"] < found["frame_ms"]
    assert found["fps"] == pytest.approx(1e3 / found["frame_ms"])


def test_a_trainings_length_follows_from_its_steps() -> None:
    times = StepTimes(plain=[0.01] * 90 + [0.02] * 10, rounds=[0.111] * 5)
    found = times.summary()
    assert (found["steps"], found["rounds"]) == (105, 5)
    assert found["step_ms"] == pytest.approx(11) and found["step_median_ms"] == pytest.approx(10)
    assert found["round_ms"] == pytest.approx(100)
    assert times.training_seconds(1000) == pytest.approx(11.5)


@pytest.fixture
def quick(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (training_run, timing_pass):
        monkeypatch.setattr(module, "stored_seeds", lambda *_, **__: film.seeds())
    monkeypatch.setattr(timing, "MOMENTS", 3)


def test_the_dedicated_pass(filmed: Path, tmp_path: Path, quick: None, monkeypatch: Any) -> None:
    conditions = Conditions(tmp_path)
    runs = chart_grid({"tiny": filmed}, methods=["frog", "ed3dgs", "static"], seeds=2, steps=12, equal_time=True)
    assert [run.method for run in timed_runs(runs)] == ["frog", "ed3dgs", "static"]
    perform(runs[0], conditions)
    told: list[tuple[int, int]] = []
    records = time_grid(runs, conditions, 16, lambda done, total: told.append((done, total)))
    assert [record["kind"] for record in records] == ["timing"] * 3, records
    assert records == [{**record} for record in records] and len(read(conditions.results)) == 3
    assert [record["scene_played"] for record in records] == ["finished", "short training", "short training"]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    for record in records:
        assert record["training"]["steps"] == 16 - timing.WARM_UP
        assert record["training"]["seconds"] > 0 and record["playback"]["fps"] > 0
        path = record["training_path"]
        assert path["device"] == "cpu" and 0 < path["forward_ms"] < path["forward_backward_ms"]
    assert records[0]["training_path"]["gaussians"] == records[0]["playback"]["gaussians"]


def test_a_method_that_cannot_be_timed_does_not_stop_the_others(filmed: Path, tmp_path: Path, quick: None) -> None:
    from frog_blender.engine.errors import FrogError

    runs = chart_grid({"tiny": filmed}, methods=["frog", "static"], seeds=1, steps=2)
    play = timing_pass.time_playback

    def sometimes(scene: ScenePlayer, camera: Any) -> Any:
        if scene.header.method == "frog":
            raise FrogError("no")
        return play(scene, camera)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing_pass, "time_playback", sometimes)
        records = time_grid(runs, Conditions(tmp_path), 8)
    assert [record["kind"] for record in records] == ["failed", "timing"]


def test_a_capture_that_cannot_be_opened_does_not_stop_the_others(filmed: Path, tmp_path: Path, quick: None) -> None:
    captures = {"tiny": filmed, "gone": tmp_path / "gone"}
    runs = chart_grid(captures, methods=["static"], seeds=1, steps=2)
    records = time_grid(runs, Conditions(tmp_path), 8)
    assert sorted(record["kind"] for record in records) == ["failed", "timing"]
